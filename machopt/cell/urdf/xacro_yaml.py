"""Reader of the YAML files of xacro's ``load_yaml`` as plain values.

No object is constructed but numbers, text, truth values, None, lists and dictionaries; the units of angle and length
of xacro are the only tags. Values that anchors repeat are counted as often as they are reached. YAML 1.1, as xacro has.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

from machopt.cell.urdf.xacro_expression import MAX_ITEMS, FunctionTable, XacroExpressionError, evaluate_expression
from machopt.errors import InputError, RobotModelError

_UNITS = {
    "!radians": 1.0,
    "!degrees": math.pi / 180.0,
    "!meters": 1.0,
    "!millimeters": 1e-3,
    "!foot": 0.3048,
    "!inches": 0.0254,
}
_PLAIN = frozenset(f"tag:yaml.org,2002:{name}" for name in ("str", "int", "float", "bool", "null"))
_CONSTANTS = FunctionTable(pi=math.pi)


def read_plain_yaml(text: str, path: Path) -> object:
    """Return the content of a YAML file.

    Args:
        text: Text of the file.
        path: Path of the file.

    Returns:
        Numbers, text, truth values, None, lists and dictionaries.

    Raises:
        InputError: no YAML, a tag or merge that is not read, or more than :data:`MAX_ITEMS` values.
    """
    import yaml

    try:
        node = yaml.compose(text, Loader=yaml.SafeLoader)
        return None if node is None else _PlainYamlReader(path).value(node)
    except (yaml.YAMLError, ValueError, TypeError, RecursionError) as problem:
        raise RobotModelError(
            f"is no YAML that can be read: {' '.join(str(problem).split())[:200]}", file=path
        ) from None


class _PlainYamlReader:
    def __init__(self, path: Path) -> None:
        import yaml

        self.yaml, self.path, self.left = yaml, path, MAX_ITEMS

    def value(self, node: Any) -> object:
        self.left -= 1
        if self.left < 0:
            raise self.error(node, f"holds more than {MAX_ITEMS} values")
        kind = {self.yaml.MappingNode: "map", self.yaml.SequenceNode: "seq"}.get(type(node))
        if kind is not None and node.tag != f"tag:yaml.org,2002:{kind}":
            raise self.error(node, f"has the tag {node.tag}, which is not read")
        if kind == "map":
            out: dict[object, object] = {}
            for key, value in node.value:
                name = self.value(key)
                if key.tag == "tag:yaml.org,2002:merge" or isinstance(name, (list, dict)):
                    raise self.error(key, "merges or keys that are no plain values are not read; write the values out")
                if name in out:
                    raise self.error(key, f"has the key {name!r} twice; keep one")
                out[name] = self.value(value)
            return out
        if kind == "seq":
            return [self.value(item) for item in node.value]
        if node.tag in _UNITS:
            try:
                number = evaluate_expression(str(node.value), _CONSTANTS)
            except XacroExpressionError as problem:
                raise self.error(node, f"{node.tag} {node.value!r}: {problem}") from None
            if not isinstance(number, (int, float)):
                raise self.error(node, f"{node.tag} {node.value!r} is no number")
            return float(number) * _UNITS[node.tag]
        if node.tag not in _PLAIN and not node.tag.endswith(":timestamp") and not node.tag.endswith(":merge"):
            raise self.error(node, f"has the tag {node.tag}; valid: {', '.join(_UNITS)}")
        if node.tag not in _PLAIN:
            return str(node.value)
        found: object = self.yaml.constructor.SafeConstructor().construct_object(node)
        return found

    def error(self, node: Any, message: str) -> InputError:
        return RobotModelError(message, file=self.path, where=f"line {node.start_mark.line + 1}")
