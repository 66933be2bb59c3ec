"""Tables of scenario files, made from the dataclasses that they set."""

from __future__ import annotations

import dataclasses
import types
import typing
from collections.abc import Mapping
from functools import cache, partial
from typing import Annotated, Any, Union

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, create_model

from lunarsim.errors import InputError
from lunarsim.parts.quantity import Quantity, quantity_of


class PartSettings(BaseModel):
    """One table of a scenario: values as the file gives them, checked; `make` gives the part."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=False)

    def make(self) -> Any:
        """Return the part, in SI units and radians.

        Raises
        ------
        InputError
            If its values contradict each other; the field is the scenario's key.
        """
        cls, keys = _origin(type(self))
        values = {}
        for key, (name, q) in keys.items():
            value = _made(key, getattr(self, key))
            values[name] = q.to_si(value) if q else value
        try:
            return cls(**values)
        except InputError as error:
            raise self._named(error, keys) from None
        except (TypeError, ValueError) as error:
            said = str(error).split("\n")[0]
            raise InputError("kind", cls.__name__, f"values that it takes ({said})") from error

    def _named(self, error: InputError, keys: dict[str, tuple[str, Quantity | None]]) -> InputError:
        """Return a part's error with the scenario's key and value."""
        wrong = error.field.rpartition(".")[2]
        for key, (name, _) in keys.items():
            if wrong in (name, key):
                return InputError(key, getattr(self, key), error.problem, error.remedy)
        return error.renamed(wrong)


def _made(key: str, value: Any) -> Any:
    """Return the value of a key with nested tables made into parts and lists into tuples."""
    if isinstance(value, PartSettings):
        try:
            return value.make()
        except InputError as error:
            raise error.renamed(f"{key}.{error.field}") from None
    return tuple(_made(key, v) for v in value) if isinstance(value, list | tuple) else value


_ORIGINS: dict[type[BaseModel], tuple[type, dict[str, tuple[str, Quantity | None]]]] = {}


def _origin(model: type[BaseModel]) -> tuple[type, dict[str, tuple[str, Quantity | None]]]:
    for base in model.__mro__:
        if base in _ORIGINS:
            return _ORIGINS[base]
    raise TypeError(f"{model.__name__} was not made by settings_of")


@cache
def settings_of(cls: type) -> type[PartSettings]:
    """Return the table that sets a dataclass.

    Raises
    ------
    TypeError
        If `cls` is no dataclass.
    """
    if not dataclasses.is_dataclass(cls):
        raise TypeError(f"{cls.__module__}:{cls.__qualname__} must be a dataclass to be a part")
    hints = typing.get_type_hints(cls, include_extras=True)
    fields: dict[str, Any] = {}
    keys: dict[str, tuple[str, Quantity | None]] = {}
    for f in dataclasses.fields(cls):
        q = quantity_of(f.metadata)
        if not f.init or f.name.startswith("_") or (q is not None and q.hidden):
            continue
        key = f.name + (q.suffix if q else "")
        default: Any = ...
        if q is not None:
            default = q.default
        elif f.default is not dataclasses.MISSING:
            default = f.default
        elif f.default_factory is not dataclasses.MISSING:
            default = f.default_factory()
        annotation = _bounded(hints[f.name], q)
        if dataclasses.is_dataclass(default) and not isinstance(default, type):
            default = table_of(default)
            annotation = Annotated[annotation, BeforeValidator(partial(_completed, default))]
        fields[key] = annotation, Field(default, description=q.help if q else None)
        keys[key] = (f.name, q)
    doc = (cls.__doc__ or "").strip().splitlines()
    model: type[PartSettings] = create_model(
        cls.__name__, __base__=PartSettings, __doc__=doc[0] if doc else None, **fields
    )
    _ORIGINS[model] = (cls, keys)
    return model


def table_of(part: Any) -> PartSettings:
    """Return the table that makes a part; its values as a scenario file would give them."""
    of: type = type(part)
    model = settings_of(of)
    _, keys = _origin(model)
    values = {}
    for key, (name, q) in keys.items():
        value = getattr(part, name)
        if dataclasses.is_dataclass(value) and not isinstance(value, type):
            values[key] = table_of(value)
        else:
            values[key] = q.from_si(value) if q else value
    return model.model_validate(values)


def _completed(default: PartSettings, given: Any) -> Any:
    """Return a nested table with the default's values for the keys that it omits."""
    return dict(default) | dict(given) if isinstance(given, Mapping) else given


def _bounded(annotation: Any, q: Quantity | None) -> Any:
    """Return the annotation with bounds on its numbers; infinity and NaN are no numbers here."""
    origin, arguments = typing.get_origin(annotation), typing.get_args(annotation)
    if origin in (Union, types.UnionType):
        return Union[tuple(_bounded(a, q) for a in arguments)]  # noqa: UP007
    if origin is tuple:
        return tuple[tuple(a if a is Ellipsis else _bounded(a, q) for a in arguments)]  # type: ignore[misc]
    if dataclasses.is_dataclass(annotation) and isinstance(annotation, type):
        return settings_of(annotation)
    if annotation in (float, int):
        limits: dict[str, Any] = {"strict": True}
        if annotation is float:
            limits["allow_inf_nan"] = False
        if q is not None:
            limits |= {
                n: getattr(q, n) for n in ("gt", "ge", "lt", "le") if getattr(q, n) is not None
            }
        return Annotated[annotation, Field(**limits)]
    return Annotated[bool, Field(strict=True)] if annotation is bool else annotation


def unit_of(model: type[PartSettings], key: str) -> str:
    """Return the unit of a key of a table, "" for none."""
    _, keys = _origin(model)
    q = keys[key][1] if key in keys else None
    return q.unit if q and q.unit != "1" else ""


def bounds_of(model: type[PartSettings], key: str) -> str:
    """Return the bounds of a key in words, "" for none."""
    _, keys = _origin(model)
    q = keys[key][1] if key in keys else None
    if q is None:
        return ""
    words = [
        f"{sign} {getattr(q, name):g}"
        for name, sign in (("gt", ">"), ("ge", ">="), ("lt", "<"), ("le", "<="))
        if getattr(q, name) is not None
    ]
    return ", ".join(words)
