"""Recording folders: ``recording.yaml`` and its tables, read strictly, written to the printed digit.

::

    keys ─► read ─► columns, table, motors, targets, tilt ─► join ─► Recording ─► written
"""

from machopt.measurement.recording.recording_reader import load_recording, load_recordings
from machopt.measurement.recording.recording_writer import write_recording

__all__ = ["load_recording", "load_recordings", "write_recording"]
