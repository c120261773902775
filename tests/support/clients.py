"""Clients of both kinds behind one interface, so that one test covers both."""

from __future__ import annotations

import asyncio
import inspect

from unbend import AsyncClient, Client


class Blocking:
    """A wrapper that runs the calls of an async client or job to their end, so that one test covers both clients."""

    def __init__(self, target: object, run) -> None:
        self._target = target
        self._run = run

    def __iter__(self):
        return iter(self._run(listed(aiter(self._target))))

    def __getattr__(self, name: str):
        value = getattr(self._target, name)
        if not callable(value):
            return value

        def call(*arguments, **options):
            answer = value(*arguments, **options)
            if inspect.isasyncgen(answer):
                return self._run(listed(answer))
            answer = self._run(answer)
            return Blocking(answer, self._run) if hasattr(answer, "wait") else answer

        return call


async def listed(items) -> list:
    return [item async for item in items]


def make_client(kind: str, url: str):
    """Return a client of either kind, and a function that closes the client."""
    if kind == "sync":
        client = Client(url)
        return client, client.close
    loop = asyncio.Runner()
    client = AsyncClient(url)

    def close() -> None:
        loop.run(client.close())
        loop.close()

    return Blocking(client, loop.run), close
