"""Comments of fields as their documentation: jbw's small records say there what a field is."""

from typing import Any

from griffe import Attribute, Class, Docstring, Extension


class FieldComments(Extension):
    """Gives fields that have no docstring the comment behind them, or on the lines above."""

    def on_class_members(self, *, cls: Class, **_: Any) -> None:
        """Every field of a class, as soon as the class is read."""
        told = cls.docstring.value if cls.docstring else ""
        for name, field in cls.members.items():
            if isinstance(field, Attribute) and not field.docstring and f"{name}: " not in told:
                comment = comment_of(field)
                if comment:
                    field.docstring = Docstring(comment, lineno=field.lineno, parent=field)


def comment_of(field: Attribute) -> str:
    """The comment of a field; empty where it has none."""
    if field.lineno is None or field.endlineno is None:
        return ""
    lines = field.lines_collection[field.filepath]
    _, mark, behind = lines[field.endlineno - 1].partition("  # ")
    if mark:
        found = [behind]
    else:
        first = field.lineno - 1
        above = first
        while lines[above - 1].strip().startswith("# "):
            above -= 1
        found = [line.strip().removeprefix("# ") for line in lines[above:first]]
    text = " ".join(found).strip()
    return text[:1].upper() + text[1:].rstrip(".") + "." if text else ""
