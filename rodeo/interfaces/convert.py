"""Values of models to messages of `rodeo_msgs`, and requests back to what the models take."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from decimal import Decimal, InvalidOperation
from functools import cache
from typing import Any

import numpy as np
from pydantic import BaseModel

from rodeo.errors import InvalidRequest, RodeoError
from rodeo.host.stamps import stamp_ns
from rodeo.interfaces.fields import PACKAGE, Count, Field, How, fields_of
from rodeo.interfaces.package import kind_message, kind_models, params_fields
from rodeo.interfaces.problem import problem_of
from rodeo.money.currency import IEC, Currency
from rodeo.ros2 import types
from rodeo.text.strict_json import encode, read_json

_NUMBERS = {"int64": np.int64, "float64": np.float64, "bool": np.bool_}
_MOST_TEXT, _MOST_DIGITS = 80, 60
"""Characters of an amount, and its digits before or after the point: 1e9999999999 would fill the memory."""
_PARAMS = f"{PACKAGE}/msg/TaskParams"


def problem(error: RodeoError) -> Any:
    """rodeo_msgs/Problem of what the bridge, or this process, refused."""
    return message(problem_of(error), IEC)


def message(model: BaseModel, currency: Currency, typename: str = "") -> Any:
    """The message of an answer, by default of the type that has the model's name."""
    typename = typename or f"{PACKAGE}/msg/{type(model).__name__}"
    return _message(typename, _fields(type(model)), model, currency)


@cache
def _fields(model: type[BaseModel]) -> tuple[Field, ...]:
    return tuple(fields_of(model, request=False))


def _message(typename: str, fields: Sequence[Field], model: BaseModel, currency: Currency) -> Any:
    values: dict[str, Any] = {}
    for field in fields:
        value = getattr(model, field.source)
        if field.how is How.PARAMS:
            values[field.name] = params_message(str(getattr(model, "kind", "")), value)
            continue
        several = value if field.count is Count.MANY else [] if value is None else [value]
        if field.how is How.AMOUNT:
            texts = [f"{one:f}" for one in several], [str(currency.to_units(one)) for one in several]
            for name, written in zip(field.names, texts, strict=True):
                values[name] = written if field.count is not Count.ONE else written[0]
            continue
        written = [_one(field, one, currency) for one in several]
        if field.count is Count.ONE:
            values[field.name] = written[0]
        else:
            number = _NUMBERS.get(field.typename)
            values[field.name] = written if number is None else np.array(written, number)
    return types.new(typename, **values)


def _one(field: Field, value: Any, currency: Currency) -> Any:
    if field.how is How.TIME:
        return types.time_message(round(value * 1e9))
    if field.how is How.JSON:
        return encode(_plain(value)).decode()
    return message(value, currency) if field.how is How.NESTED else value


def _plain(value: Any) -> Any:
    """What JSON has, of the models and decimals in a mapping."""
    if isinstance(value, BaseModel):
        return value.model_dump(mode="json")
    if isinstance(value, Mapping):
        return {str(name): _plain(one) for name, one in value.items()}
    return [_plain(one) for one in value] if isinstance(value, list | tuple) else value


def params_message(kind: str, params: Mapping[str, Any]) -> Any:
    """rodeo_msgs/TaskParams. Parameters that do not fit their kind, which a chain may hold, are JSON only."""
    found = types.new(_PARAMS, json=encode(_plain(params)).decode())
    model = kind_models().get(kind)
    if model is not None:
        try:
            typed = model.model_validate(params)
        except ValueError:
            return found
        name = f"{PACKAGE}/msg/{kind_message(kind)}"
        setattr(found, kind, [_message(name, params_fields(kind), typed, Currency(18))])
    return found


def request_of(fields: Sequence[Field], sent: Any, currency: Currency) -> dict[str, Any]:
    """What a model takes, from a request. What is unset is left out. Raises InvalidRequest."""
    found: dict[str, Any] = {}
    for field in fields:
        if field.count is Count.OPTIONAL and any(len(getattr(sent, name)) > 1 for name in field.names):
            raise InvalidRequest(f"{field.name} holds one value at most", fields={field.name: "too many"})
        if field.how is How.AMOUNT:
            said = _amount(field, sent, currency)
        elif field.how is How.PARAMS:
            said = _params(str(found.get("kind", "")), getattr(sent, field.name))
        else:
            value = getattr(sent, field.name)
            several = value if field.count is not Count.ONE else [value]
            read = [_read(field, one) for one in several]
            said = read if field.count is Count.MANY else read[0] if read else None
        if said is not None:
            found[field.source] = said
    return found


def _read(field: Field, value: Any) -> Any:
    if field.how is How.TIME:
        return stamp_ns(value) / 1e9
    if field.how is How.JSON:
        return _json(field.name, value)
    # numpy's numbers are none of Python's.
    return value.item() if isinstance(value, np.generic) else value


def _json(name: str, text: str) -> dict[str, Any]:
    """Raises InvalidRequest."""
    try:
        return read_json((text or "{}").encode())
    except ValueError as error:
        raise InvalidRequest(f"{name} is no JSON object", fields={name: str(error)}) from error


def _amount(field: Field, sent: Any, currency: Currency) -> Any:
    """The amounts in IEC; None where both fields are unset. Raises InvalidRequest."""
    in_iec, in_wei = (getattr(sent, name) for name in field.names)
    if field.count is Count.ONE:
        in_iec, in_wei = [in_iec] if in_iec else [], [in_wei] if in_wei else []
    if in_iec and in_wei and len(in_iec) != len(in_wei):
        raise _disagree(field)
    amounts = []
    for number in range(max(len(in_iec), len(in_wei))):
        said = set()
        try:
            if in_iec:
                said.add(_decimal(in_iec[number]))
            if in_wei:
                said.add(currency.from_units(int(_decimal(in_wei[number], whole=True))))
        except (InvalidOperation, ValueError) as error:
            raise InvalidRequest(
                "not an amount: decimal text", fields={field.name: "decimal text, or whole wei"}
            ) from error
        if len(said) > 1:
            raise _disagree(field)
        amounts.append(f"{said.pop():f}")
    if field.count is Count.MANY:
        return amounts
    return amounts[0] if amounts else None


def _decimal(text: str, whole: bool = False) -> Decimal:
    """Raises ValueError and InvalidOperation."""
    amount = Decimal(text) if len(text) <= _MOST_TEXT else None
    if amount is None or not amount.is_finite() or abs(amount.adjusted()) > _MOST_DIGITS:
        raise ValueError("no amount of money")
    if whole and not text.isdecimal():
        raise ValueError("not a whole number")
    return amount


def _disagree(field: Field) -> InvalidRequest:
    return InvalidRequest(
        f"{field.name} and {field.wei} do not agree", fields={field.name: f"differs from {field.wei}"}
    )


def _params(kind: str, sent: Any) -> dict[str, Any]:
    """The parameters of a task of `kind`, from the one field that says them. Raises InvalidRequest."""
    typed = [name for name in kind_models() if len(getattr(sent, name))]
    if not typed:
        return _json("params.json", sent.json)
    if typed != [kind] or sent.json:
        said = [*typed, *(["json"] if sent.json else [])]
        raise InvalidRequest(
            f"say params.json or params.{kind}, one of them", fields={"params": ", ".join(said)}
        )
    return request_of(params_fields(kind), getattr(sent, kind)[0], Currency(18))
