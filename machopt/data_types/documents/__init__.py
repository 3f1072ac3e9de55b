"""What each command writes or prints as JSON, typed: one file a document, the schemas beside them.

``optimize.OptimizeResult`` result.json · ``diagnosis.DiagnosisResult`` diagnosis.json · ``identification.
IdentificationResult`` identification.json · ``maps.MapResult`` map.json · ``poses.PosesResult`` plan.json ·
``batch.BatchResult`` batch.json, ``batch.BatchRecord`` job.json and ``batch.JobTiming`` timing.json ·
printed by ``--json`` alone: ``inspected``, ``cells``, ``verified``; sent to a page: ``view``. Units stand in the keys.
"""
