"""Results by their key: as JSON, as a table, as the file they are kept in."""

import csv
import hashlib
import io
from collections.abc import Callable
from http import HTTPStatus
from typing import Annotated

from anyio.to_thread import run_sync
from fastapi import APIRouter, Header, HTTPException, Path, Request, Response

from service.api.contract import Responses, problems
from service.api.headers import choose, matches
from service.api.services import services_of
from service.auth.dependencies import READ
from service.cache.hdf5 import to_hdf5
from service.cache.record import Record
from service.cache.tables import residuals_of
from service.schemas import Result

router = APIRouter(tags=["results"], dependencies=[READ])


def to_csv(record: Record) -> bytes:
    """Return the table of a result.

    The history of a run, or its end if it has none; the trials of a search; the residuals of a calibration.
    """
    if record.operation == "trajectory" and record.history is not None:
        names, columns = list(record.history), [column.tolist() for column in record.history.values()]
    elif residuals := residuals_of(record):
        names, columns = list(residuals), list(residuals.values())
    else:
        records = [record.answer["final"]] if record.operation == "trajectory" else record.answer["iterations"]
        names = list(records[0])
        columns = [[each[name] for each in records] for name in names]
    text = io.StringIO()
    writer = csv.writer(text)
    writer.writerow(names)
    for row in zip(*columns, strict=True):  # all at once would hold the interpreter lock until the last
        writer.writerow(row)
    return text.getvalue().encode()


REPRESENTATIONS: dict[str, Callable[[Record], bytes]] = {
    "application/json": lambda record: record.json,
    "text/csv": to_csv,
    "application/x-hdf5": to_hdf5,
}
"""Every form a result is given in, the usual one first."""

DECLARED: Responses = {
    200: {
        "description": "The result, in the form that `Accept` asks for.",
        "headers": {"ETag": {"description": "Of this form; strong.", "schema": {"type": "string"}, "required": True}},
        "content": {"text/csv": {"schema": {"type": "string"}}, "application/x-hdf5": {}},
    },
    304: {"description": "The client has this form of the result."},
    **problems(404, 406, 422, 500),
}
KEY = {"pattern": "^[0-9a-f]{64}$"}


@router.get("/results/{key}", response_model=Result, responses=DECLARED)
async def get_result(
    request: Request,
    key: Annotated[str, Path(description="Of an answer.", json_schema_extra=KEY)],
    if_none_match: Annotated[str, Header(alias="If-None-Match", description="Entity tags the client has.")] = "",
) -> Response:
    """Give the result with this key: JSON, CSV or HDF5 (all of it).

    CSV is the history of a run, the trials of a search, the residuals of a calibration.
    """
    media_type = choose(request.headers.get("accept", "*/*"), list(REPRESENTATIONS))
    if media_type is None:
        raise HTTPException(HTTPStatus.NOT_ACCEPTABLE, f"a result is given as {', '.join(REPRESENTATIONS)}")
    record = await services_of(request).queries.result(key)
    if record is None:
        raise HTTPException(HTTPStatus.NOT_FOUND, "no result is kept under this key")
    content = await run_sync(REPRESENTATIONS[media_type], record)
    headers = {"ETag": f'"{hashlib.sha256(content).hexdigest()[:32]}"', "Vary": "Accept"}
    if matches(if_none_match, headers["ETag"]):
        return Response(status_code=HTTPStatus.NOT_MODIFIED, headers=headers)
    return Response(content, media_type=media_type, headers=headers)
