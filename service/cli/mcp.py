"""`ricochet mcp`: the solver as tools of the Model Context Protocol, over standard input and output."""

import argparse
import json
from collections.abc import Mapping
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

from service.cli.arguments import (
    FAILED,
    CommandError,
    RefusedError,
    add_data_dir,
    add_url,
    examples,
)

if TYPE_CHECKING:
    from service.cli.client import Client


def add_mcp(parser: argparse.ArgumentParser) -> None:
    """Define `ricochet mcp`."""
    parser.description = (
        "Offer critical angles, trajectories, uncertainty and wall thicknesses as tools of the Model Context Protocol, "
        "over standard input and output, until the input ends. Computed here or by a service. Needs the extra mcp."
    )
    parser.epilog = examples("ricochet mcp", "ricochet mcp --url http://127.0.0.1:8000")
    add_data_dir(parser)
    add_url(parser)
    parser.set_defaults(run=run_mcp)


def run_mcp(args: argparse.Namespace) -> int:
    """Serve until standard input ends.

    Raises
    ------
    CommandError
        If the SDK of the protocol is not installed.
    """
    if find_spec("mcp") is None:
        from service.settings import missing_package

        raise CommandError(missing_package("this command", "the package mcp", "mcp"), FAILED)
    import anyio

    from service.cli.jobs import service_for

    with service_for(args) as client:
        anyio.run(serve, client)
    return 0


async def serve(client: "Client") -> None:
    """Answer messages; their computations run in threads, one for each."""
    from anyio.to_thread import run_sync
    from mcp.server.stdio import stdio_server

    from service.api.mcp_tools import ToolError, server_of

    async def compute(operation: str, body: Mapping[str, Any], _: Any) -> dict[str, Any]:
        try:
            answer: dict[str, Any] = json.loads(await run_sync(client.compute, operation, dict(body)))
            if "key" not in answer:  # a job: more samples than are answered at once
                await run_sync(client.delete, answer["id"])
                raise ToolError({"title": "This takes too many samples: lower sampling.max_samples"})
        except RefusedError as error:
            raise ToolError(error.problem) from None
        except CommandError as error:
            raise ToolError({"title": "The service gives no answer", "detail": str(error)}) from None
        return answer

    server = server_of(compute)
    async with stdio_server() as (reading, writing):
        await server.run(reading, writing, server.create_initialization_options())
