"""Output folders: whole or not there, one writer at a time, and with a manifest of what they hold.

``folder`` writes and swaps, ``lock`` keeps a second run out, ``hashes`` and ``manifest`` say what lies in a folder and
whether it still does.
"""

from machopt.output.folder import is_machopt_output, output_folder
from machopt.output.jsonfile import read_result, write_json, write_result
from machopt.output.manifest import MANIFEST, read_manifest, write_manifest

__all__ = [
    "MANIFEST",
    "is_machopt_output",
    "output_folder",
    "read_manifest",
    "read_result",
    "write_json",
    "write_manifest",
    "write_result",
]
