"""Error messages of recipes: the rule for each error type of pydantic."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import pydantic

from nacre.core.errors import did_you_mean

MAX_KEYS = 4  # in the message for a table without an example form


def rule_of(error_type: str, context: Mapping[str, Any], given: Any, tables: Iterable[type[pydantic.BaseModel]]) -> str:
    """Return the end of the sentence "it should ...".

    Args:
        error_type: pydantic's error name.
        context: numbers and names of the error.
        given: the value in the recipe.
        tables: table models of the recipe, for their example forms.
    """
    if error_type in ("model_type", "model_attributes_type", "dataclass_type"):
        name = context.get("class_name")
        return f"be a table{next((_form(table) for table in tables if table.__name__ == name), '')}"
    if error_type == "literal_error":
        allowed = str(context["expected"]).replace("'", '"')
        words = [word for word in allowed.split('"') if word.strip(" ,") not in ("", "or")]
        one_of = "one of " if len(words) > 1 else ""
        return f"be {one_of}{allowed}{('.' + hint) if (hint := did_you_mean(str(given), words)) else ''}"
    if error_type in COUNTS:
        word, key = COUNTS[error_type]
        one, more = ("character", "characters") if error_type.startswith("string") else ("entry", "entries")
        return f"have {word} {context[key]} {one if context[key] == 1 else more}"
    if error_type in LIMITS:
        word, key = LIMITS[error_type]
        return f"be {word} {_short(context[key])}"
    return WORDS[error_type]


LIMITS = {
    "greater_than": ("above", "gt"),
    "greater_than_equal": ("at least", "ge"),
    "less_than": ("below", "lt"),
    "less_than_equal": ("at most", "le"),
    "multiple_of": ("a multiple of", "multiple_of"),
}
COUNTS = {
    "too_short": ("at least", "min_length"),
    "too_long": ("at most", "max_length"),
    "string_too_short": ("at least", "min_length"),
    "string_too_long": ("at most", "max_length"),
}
WORDS = {
    "bool_type": "be true or false",
    "bool_parsing": "be true or false",
    "float_type": "be a number",
    "float_parsing": "be a number",
    "finite_number": "be finite",
    "int_type": "be a whole number",
    "int_parsing": "be a whole number",
    "int_parsing_size": "be a smaller whole number",
    "int_from_float": "be a whole number",
    "string_type": "be text",
    "string_unicode": "be text",
    "list_type": "be a list",
    "tuple_type": "be a list",
    "dict_type": "be a table",
    "mapping_type": "be a table",
    "invalid_key": "be text, as every key is",
    "none_required": "be left out",
    "recursion_loop": "not hold itself",
    "is_instance_of": "be something else",
}


def _form(table: type[pydantic.BaseModel]) -> str:
    forms = getattr(table, "forms", ())
    if forms:
        return f", such as {forms[0]}"
    keys = [info.alias or name for name, info in table.model_fields.items()]
    needed = [name for name, info in table.model_fields.items() if info.is_required()]
    shown = needed or keys
    if not shown:
        return ""
    more = ", ..." if len(keys) > len(shown[:MAX_KEYS]) else ""
    return f" with the key{'s' * (len(shown) > 1 or bool(more))} {', '.join(shown[:MAX_KEYS])}{more}"


def _short(number: Any) -> str:
    return str(number) if isinstance(number, int) else f"{number:g}"
