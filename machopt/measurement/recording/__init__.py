"""Recording folders: ``recording.yaml`` and its tables, read strictly and written to the printed digit.

::

    recording_schema ─► recording_reader ─► columns, table, motors, targets, tilt ─► recording_merge ─► Recording
                                                                                           Recording ─► recording_writer
"""

from machopt.measurement.recording.cutting_recording_reader import load_cutting_recording
from machopt.measurement.recording.recording_reader import load_recording, load_recordings
from machopt.measurement.recording.recording_writer import write_recording

__all__ = ["load_cutting_recording", "load_recording", "load_recordings", "write_recording"]
