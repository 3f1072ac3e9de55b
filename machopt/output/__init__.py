"""Output folders: whole or not there, one writer at a time, and with a manifest of what they hold.

``output_folder`` writes and ``folder_swap`` swaps, ``file_lock`` keeps a second run out, ``file_hashes`` and
``manifest_file`` say what lies in a folder and whether it still does.
"""

from machopt.output.json_files import read_result, write_json, write_result
from machopt.output.manifest_file import MANIFEST, read_manifest, write_manifest
from machopt.output.output_folder import is_machopt_output, write_output_folder

__all__ = [
    "MANIFEST",
    "is_machopt_output",
    "read_manifest",
    "read_result",
    "write_json",
    "write_manifest",
    "write_output_folder",
    "write_result",
]
