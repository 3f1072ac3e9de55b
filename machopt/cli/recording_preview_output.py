"""Output of ``--dry-run`` of identify and diagnose."""

from __future__ import annotations

import argparse
import json


def print_recording_preview(args: argparse.Namespace) -> int:
    """Print how a recording is understood; nothing is computed or written.

    Args:
        args: The arguments of the command: cell, recording, json, quiet, allow_external.

    Returns:
        Exit code 0.
    """
    from machopt.commands.recording_preview import format_recording_preview, preview_recording, summarise_preview

    preview = preview_recording(args.cell, args.recording, allow_external=args.allow_external)
    if args.json:
        print(json.dumps(summarise_preview(preview)))
    elif not args.quiet:
        print("\n".join(format_recording_preview(preview)))
    return 0
