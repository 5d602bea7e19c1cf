"""Problems as the contract has them (RFC 9457)."""

from typing import Annotated

from pydantic import Field

from service.schemas.quantities import Part, with_examples

TOO_SHORT = {
    "pointer": "/projectile/length_m",
    "detail": "must be at least the length of the nose, 0.132665 m, got 0.1 m",
}
INVALID = {
    "type": "urn:ricochet:problem:invalid-request",
    "title": "The request does not fit the contract",
    "status": 422,
    "detail": ": ".join(TOO_SHORT.values()),
    "instance": "/cra",
    "errors": [TOO_SHORT],
}


class ProblemError(Part):
    """One thing that is wrong with the request."""

    model_config = with_examples(TOO_SHORT)

    pointer: Annotated[
        str,
        Field(
            description="JSON pointer (RFC 6901) into the request body; empty for all of it. Of a JSONL body the first "
            "step is the line, counted from 0."
        ),
    ]
    detail: Annotated[str, Field(description="What is wrong with it.")]


class Problem(Part):
    """Why there is no answer (RFC 9457)."""

    model_config = with_examples(INVALID)

    type: Annotated[str, Field(description="Stable, for programs; `about:blank` where the status says it all.")]
    title: Annotated[str, Field(description="Of the type.")]
    status: Annotated[int, Field(ge=400, le=599, description="The HTTP status.")]
    detail: Annotated[str, Field(description="Of this occurrence.")]
    instance: Annotated[str, Field(description="The path that was asked.")]
    errors: Annotated[list[ProblemError], Field(description="What is wrong with the request body, if anything is.")]
