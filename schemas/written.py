"""The class of the models that users write in Python: the errors of their calls are one plain line."""

from typing import Any

from pydantic import ValidationError

from .base import Model
from .errors import DefinitionError, shortened


class Written(type(Model)):  # type: ignore[misc]
    """The class of a model that users write: its call raises one plain line; a message keeps pydantic's error."""

    is_short = True
    """Whether its call is shown beside a fault; the many fields of a system say nothing of the one that is wrong."""
    takes_limits = False
    """Whether two numbers without names are its limits."""
    joint = "_"
    """Allowed in its name."""

    def __call__(cls, *limits: float, **fields: Any) -> Any:
        """Make one by names; the two limits of a parameter may stand first, without theirs.

        Raises:
            DefinitionError: a field is missing, unknown or wrong.

        """
        given = ", ".join([*map(repr, limits), *(f"{name}={value!r}" for name, value in fields.items())])
        place = f"{shortened(f'{cls.__name__}({given})', 120)}: " if cls.is_short else ""
        if limits and not cls.takes_limits:
            raise DefinitionError(f"{place}give the fields of {cls.__name__} by their names")
        try:
            return super().__call__(**dict(zip(("low", "high")[: 2 * bool(limits)], limits, strict=True)), **fields)
        except ValidationError as error:
            of_limits = cls.takes_limits and error.errors()[0]["loc"][:1] in {("low",), ("high",)}
            raise DefinitionError(f"{place}{_fault(error, cls)}{TWO_NUMBERS if of_limits else ''}") from None
        except (ValueError, TypeError):  # of them there are fewer, more, or one twice
            raise DefinitionError(f"{place}not two limits{TWO_NUMBERS}") from None


TWO_NUMBERS = "; give two numbers, as in Parameter(0, 5, unit='m')"


def _fault(error: ValidationError, model: Any) -> str:
    """Return the first fault of the fields in words."""
    fault = error.errors(include_url=False)[0]
    where = ".".join(map(str, fault["loc"]))
    match fault["type"]:
        case "missing":
            return f"{model.__name__} needs {where}"
        case "extra_forbidden":
            return f"{model.__name__} has no {where}; it has {', '.join(model.model_fields)}"
        case "value_error":
            return str(fault["ctx"]["error"])
        case "float_type" | "finite_number":
            wanted = "a finite number is needed"
        case "string_pattern_mismatch":
            joint = model.joint if where == "name" else "_"
            wanted = f"a name consists of a-z, 0-9 and {joint}, the first is a letter"
        case _:
            wanted = str(fault["msg"]).replace("Input should", "it must")
    return f"{where}: {fault['input']!r}: {wanted}"
