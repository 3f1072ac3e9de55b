"""JSON documents that each command writes or prints, one file for each document; their schemas are in this folder.

``optimize_document`` result.json · ``diagnosis_document`` diagnosis.json · ``identification_document``
identification.json · ``map_document`` map.json · ``pose_plan_document`` plan.json · ``place_document`` place.json ·
``batch_document`` batch.json, job.json and timing.json · ``manifest_document`` manifest.json. Printed by ``--json``
alone: ``inspect_documents``, ``cell_documents``, ``verify_document``. Sent to a page: ``view_document``. Keys carry
their units.
"""
