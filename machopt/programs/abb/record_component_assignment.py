"""Components of RAPID records, such as ``p10.trans.z`` or ``wobj1.oframe.trans.x``, by their index in the value."""

from __future__ import annotations

_POSE = {"trans": (0, "pos"), "rot": (1, "orient")}
_RECORDS: dict[str, dict[str, tuple[int, str]]] = {  # record → component → place and record of the component
    "robtarget": {
        "trans": (0, "pos"),
        "rot": (1, "orient"),
        "robconf": (2, "confdata"),
        "extax": (3, "extjoint"),
    },
    "jointtarget": {"robax": (0, "robjoint"), "extax": (1, "extjoint")},
    "wobjdata": {
        "robhold": (0, ""),
        "ufprog": (1, ""),
        "ufmec": (2, ""),
        "uframe": (3, "pose"),
        "oframe": (4, "pose"),
    },
    "tooldata": {"robhold": (0, ""), "tframe": (1, "pose"), "tload": (2, "")},
    "pose": _POSE,
    "pos": {"x": (0, ""), "y": (1, ""), "z": (2, "")},
    "orient": {f"q{k + 1}": (k, "") for k in range(4)},
    "robjoint": {f"rax_{k + 1}": (k, "") for k in range(6)},
    "extjoint": {f"eax_{letter}": (k, "") for k, letter in enumerate("abcdef")},
    "confdata": {"cf1": (0, ""), "cf4": (1, ""), "cf6": (2, ""), "cfx": (3, "")},
    "speeddata": {"v_tcp": (0, ""), "v_ori": (1, ""), "v_leax": (2, ""), "v_reax": (3, "")},
}


def replace_component(value: object, record: str, path: str, new: object) -> object:
    """A record's value with one component changed.

    Args:
        value: nested lists as they are written in the program.
        record: its type, such as ``robtarget``.
        path: components with a point before each, such as ``.trans.z``.
        new: the component's value.

    Returns:
        A changed copy; None where the record or the component is not known.
    """
    first, _, rest = path.lstrip(".").partition(".")
    place = _RECORDS.get(record, {}).get(first)
    if not path.startswith(".") or place is None or not isinstance(value, list) or place[0] >= len(value):
        return None
    inner = replace_component(value[place[0]], place[1], "." + rest, new) if rest else new
    return None if inner is None else [*value[: place[0]], inner, *value[place[0] + 1 :]]
