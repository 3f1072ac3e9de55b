"""Comments at the end of program lines."""

from __future__ import annotations


def split_comment(raw: str, mark: str) -> tuple[str, str]:
    """Split a line into code and comment; a mark inside quotes begins no comment.

    Args:
        raw: Text of the line.
        mark: Character that begins a comment.

    Returns:
        Code and comment.
    """
    at = raw.find(mark)
    if at >= 0 and '"' in raw[:at]:
        quoted, at = False, -1
        for k, c in enumerate(raw):
            quoted ^= c == '"'
            if c == mark and not quoted:
                at = k
                break
    return (raw.strip(), "") if at < 0 else (raw[:at].strip(), raw[at + 1 :].strip())
