"""Detection of the dialect of a CAM file from its beginning, so that only the matching reader is imported."""

from __future__ import annotations

import re

NCI = re.compile(
    r"\A\s*[0-9]{1,5}\s*\n.*\n\s*[0-9]{1,5}\s*\n(?:.*\n)*?\s*(?:1002|1001|1000|1011|1012|1013|1014|1050)\s*\n"
)
HEIDENHAIN = re.compile(r"^\s*[0-9]*\s*BEGIN\s+PGM\b", re.IGNORECASE | re.MULTILINE)
HEIDENHAIN_ISO = re.compile(r"^[ \t]*%(?!_N_)[ \t]*\S+[ \t]+G7([01])\b", re.IGNORECASE | re.MULTILINE)
PART_PROGRAM = re.compile(
    r"^\s*(?:\w+\s*=\s*(?:point|line|circle|plane|vector|matrix|cylndr|cone|sphere|pattrn|tabcyl)\s*/"
    r"|go\s*/\s*(?:to|on|past|tanto)|clprnt\b|loopst\b|jumpto\s*/|obtain\s*,|[a-z]\w*\s*=\s*[-+.\w(])",
    re.IGNORECASE | re.MULTILINE,
)
CL_DATA = re.compile(
    r"^\s*(?:GOTO\s*/|TOOL PATH\s*/|CUTTER\s*/|LOADTL\s*/|FEDRAT\s*/|\$\$|PARTNO|FROM\s*/|MULTAX|CIRCLE\s*/)",
    re.IGNORECASE | re.MULTILINE,
)
G_CODE = re.compile(
    r"^\s*/?\s*(?:N\s*[0-9]+\s*)?(?:\([^)]*\)\s*)?(?:[GXYZMT]\s*[+-]?\s*[0-9]*\.?[0-9]|R[0-9]+\s*=)",
    re.IGNORECASE | re.MULTILINE,
)
