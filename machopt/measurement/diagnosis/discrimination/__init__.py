"""Which measurement tells rival explanations apart.

DiagnosisResult ─disputes─► Diagnosed ─predicted─► laws at poses × loads ─separate─► the plan that splits them
"""
