"""Sections of a configuration whose constants have other values, for tests of what depends on them."""

from dataclasses import fields
from typing import Any, TypeVar

Section = TypeVar("Section")


def with_constants(section: Section, **values: Any) -> Section:
    """Return the section with other values of its class variables."""
    kind: Any = type(section)
    other = type(kind.__name__, (kind,), values)
    found: Section = other(**{field.name: getattr(section, field.name) for field in fields(kind)})
    return found
