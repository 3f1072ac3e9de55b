"""Recording folders: ``recording.yaml`` and its tables, read strictly, written to the printed digit.

::

    keys ─► read ─► columns, table, motors, targets, tilt ─► join ─► Recording ─► written
"""

from machopt.formats.recording.read import load_recording, load_recordings
from machopt.formats.recording.written import write_recording

__all__ = ["load_recording", "load_recordings", "write_recording"]
