"""The least that FastAPI can do, served with the options of the service."""

import asyncio

from fastapi import FastAPI

from service.cli.server import Server
from service.settings import Settings


def main() -> None:
    app, settings = FastAPI(openapi_url=None), Settings()
    app.state.stopping, app.state.settings = asyncio.Event(), settings  # what connections look at

    @app.get("/empty")
    async def empty() -> None:
        return None

    Server(app, settings).run()


if __name__ == "__main__":
    main()
