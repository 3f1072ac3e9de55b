"""The command ``view``: a plan in a local browser, to view and to steer."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

from machopt.cli.compilation_notice import announce_compilation
from machopt.cli.effects_notice import warn_of_effect_code
from machopt.cli.progress_display import ProgressDisplay, parse_port
from machopt.cli.reading_options import build_reading_parser, convert_reading_options
from machopt.cli.shared_options import add_shared_option

Commands = Any  # argparse keeps its subparsers' type private


def add_commands(commands: Commands, common: argparse.ArgumentParser) -> None:
    """Add the command to the parser.

    Args:
        commands: The sub-parsers of the main parser.
        common: Parent parser with the options of every command.
    """
    p = commands.add_parser(
        "view",
        parents=[common, build_reading_parser()],
        help="show a plan in 3-D in a local browser, change its constraints and plan again",
    )
    p.add_argument(
        "places",
        type=Path,
        nargs="+",
        metavar="OUT | CELL [TOOLPATH]",
        help="output folder of optimize (its cell and toolpath are found by their hashes, or given after it), or a "
        "cell; with a toolpath the cell is planned and can be steered",
    )
    add_shared_option(p, "--plan")
    add_shared_option(p, "--set")
    add_shared_option(p, "--process")
    add_shared_option(p, "--seed", default=None, help="seed of the random search around obstacles (default: 0)")
    add_shared_option(p, "--allow-external")
    p.add_argument("--port", type=parse_port, default=0, help="port on 127.0.0.1 (default: any free port)")
    p.add_argument(
        "--save",
        type=Path,
        default=Path("plan.yaml"),
        metavar="FILE",
        help="file in which the page saves the planning options (default: plan.yaml)",
    )
    add_shared_option(p, "--force")
    p.add_argument("--open", action="store_true", help="open the page in the default browser")
    p.add_argument("--as-it-is", action="store_true", help="show the report of the output folder without planning")
    add_shared_option(p, "--effects")
    p.set_defaults(run=_run_view)


def _run_view(args: argparse.Namespace) -> int:
    from machopt.commands.optimize.request import OptimizeRequest
    from machopt.effects.user_effects import activate_user_effects, load_effect_files
    from machopt.view.run import ViewRequest, serve_view

    request = OptimizeRequest(
        cell=args.places[0],
        toolpath=args.places[-1],
        out=Path("steered"),
        overwrite=args.overwrite,
        plan_file=args.plan,
        process=args.process,
        overrides=(*args.set, *(() if args.seed is None else (f"seed={args.seed}",))),
        reading=convert_reading_options(args),
        allow_external=args.allow_external,
        effects=tuple(args.effects),
    )
    view_request = ViewRequest(
        paths=tuple(args.places),
        request=request,
        save=args.save,
        words=_list_reading_arguments(args),
        port=args.port,
        report_only=args.as_it_is,
    )
    warn_of_effect_code(args)
    with activate_user_effects(load_effect_files(request.effects)):
        show = not (args.quiet or args.json)
        with ProgressDisplay(show=show) as display, announce_compilation(display):
            server = serve_view(
                view_request, lambda text: None if args.quiet else print(f"machopt: {text}"), display.show_stage
            )
        try:
            print(server.url, flush=True)
            if not args.quiet:
                print("machopt: for this machine alone; Ctrl-C ends it", file=sys.stderr)
            if args.open:
                import webbrowser

                webbrowser.open(server.url)
            server.serve_actions()
        except KeyboardInterrupt:
            pass  # requested
        finally:
            server.close()
    return 0


def _list_reading_arguments(args: argparse.Namespace) -> tuple[str, ...]:
    """The reading options as they were given, for the command that plans the same."""
    out: list[str] = []
    for name in ("unit", "machine", "feed", "tool_axis", "decimals", "cycle_order", "max_extent", "kind"):
        value = getattr(args, name)
        if value is not None:
            out.append(f"--{name.replace('_', '-')}={value}")
    for value in args.offset:
        out.append(f"--offset={value}")
    for value in args.accept_unknown:
        out.append(f"--accept-unknown={value}")
    if args.process is not None:
        out.append(f"--process={args.process}")
    for value in args.effects:
        out.append(f"--effects={value}")
    return (*out, *(["--strict"] if args.strict else []), *(["--allow-external"] if args.allow_external else []))
