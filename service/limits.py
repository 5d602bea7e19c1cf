"""What any client may take of the service; each limit with its reason. Those of bodies and queues are in `settings`."""

from typing import Annotated

from pydantic import Field
from pydantic_settings import BaseSettings


class Limits(BaseSettings):
    """Bounds on what one client can hold or ask for."""

    max_body_depth: Annotated[
        int,
        Field(
            ge=10,
            le=190,
            description="Objects and lists in one another that a body may have: the deepest request has 7. The parser "
            "itself goes no deeper than some 200.",
        ),
    ] = 20
    max_panel_steps: Annotated[
        float,
        Field(
            gt=0.0,
            description="Panels times time steps of one run of the paper's method, up to its termination time. [1] "
            "96,000 panels with steps of 1 µs over the usual 0.05 s are 4.8e9, some 100 s of work if no event ends it.",
        ),
    ] = 5e9
    max_head_bytes: Annotated[
        int,
        Field(
            ge=1024,
            description="Longest head of a request, its address and headers. Browsers with many cookies send 4 kB; the "
            "server's own parser has no limit.",
        ),
    ] = 16 * 1024
    max_head_fields: Annotated[
        int, Field(ge=16, description="Headers of a request: browsers and proxies send some 30; each is looked at.")
    ] = 100
    head_seconds: Annotated[
        float,
        Field(
            gt=0.0,
            description="For the head of a request to arrive once its connection is there: more than any network "
            "needs, and a connection that says nothing is not kept for longer.",
        ),
    ] = 10.0
    body_seconds: Annotated[
        float,
        Field(
            gt=0.0,
            description="How long the service waits for a body in all, beside the time that it takes at "
            "`slowest_bytes_per_second`: a link that is lost for some seconds does not lose the request.",
        ),
    ] = 20.0
    send_seconds: Annotated[
        float,
        Field(
            gt=0.0,
            description="How long a client that reads too slowly, or not at all, keeps its connection and what waits "
            "to be sent to it.",
        ),
    ] = 30.0
    slowest_bytes_per_second: Annotated[
        int,
        Field(ge=1, description="Least that a client must send or read over time: a tenth of a poor mobile network."),
    ] = 4 * 1024
    discard_seconds: Annotated[
        float,
        Field(
            gt=0.0,
            description="How long the rest of a request is read that has been answered already, so that the client "
            "gets to the answer; then the connection is closed.",
        ),
    ] = 2.0
    max_discarded_bytes: Annotated[
        int,
        Field(
            ge=0,
            description="How much of such a rest is read at most: half a second of work.",
        ),
    ] = 64 * 1024 * 1024
    max_connections: Annotated[
        int,
        Field(
            ge=8,
            description="Open connections. Each takes a file descriptor, of which a process usually has 1,024, and "
            "some 10 kB; those beyond are told to come back.",
        ),
    ] = 800
    max_streams: Annotated[
        int,
        Field(ge=1, description="Event streams open at once: each wakes up with every change of its job."),
    ] = 200
    max_owner_streams: Annotated[
        int,
        Field(
            ge=1,
            description="Event streams of one owner: more than a browser opens, and ten owners still find room.",
        ),
    ] = 20
    max_owner_queries: Annotated[
        int,
        Field(
            ge=1,
            description="Single queries of one owner that may wait for a worker or run, where keys are asked for: half "
            "a second to some seconds of work, and the others need not wait behind more.",
        ),
    ] = 100
