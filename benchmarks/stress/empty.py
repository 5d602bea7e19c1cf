"""The least that FastAPI can do, served with the options of the service."""

import asyncio

from fastapi import FastAPI

from service.commands.server import Server
from service.settings import Settings


def main() -> None:
    app = FastAPI(openapi_url=None)
    app.state.stopping = asyncio.Event()

    @app.get("/empty")
    async def empty() -> None:
        return None

    Server(app, Settings()).run()


if __name__ == "__main__":
    main()
