"""What each command writes as JSON, typed and versioned: one file a document, the schemas beside them.

``optimize.OptimizeResult`` result.json · ``diagnosis.DiagnosisResult`` diagnosis.json · ``identification.
IdentificationResult`` identification.json · ``maps.MapResult`` map.json · ``poses.PosesResult`` plan.json ·
``batch.BatchResult`` batch.json and ``batch.BatchRecord`` job.json. Units stand in the keys.
"""
