"""The synchronous client."""

from __future__ import annotations

from unbend.client.sync_client import SyncClient
from unbend.results.shapes import ShapeRecord


class Client(SyncClient):
    """A connection to a running service, with the methods and results of `Library`; see `AsyncClient` for asyncio.

    Parameters
    ----------
    base_url : str, optional
        For example "http://127.0.0.1:8000"; by default the environment variable UNBEND_URL.
    api_key : str, optional
        By default the environment variable UNBEND_API_KEY.
    retry_seconds : float, default 600
        How long a request waits and is repeated while the service is at a limit.

    Raises
    ------
    UnbendError
        By every method, the error that the service reports, of the same class as in the library: for example
        NotFoundError if there is no such shape or job, and ParameterError if a value is refused. `status` and
        `problem` have the whole response.
    ServiceError
        By every method, if the service cannot be reached. A request is repeated first, if it is safe to repeat it.

    Examples
    --------
    >>> with Client("http://127.0.0.1:8000") as client:         # doctest: +SKIP
    ...     client.add("cat.off", label="cat")
    ...     client.classify("unknown.ply")[0].label
    """

    def __len__(self) -> int:
        return self.count()

    def __contains__(self, shape: object) -> bool:
        shape_id = shape.id if isinstance(shape, ShapeRecord) else shape
        return isinstance(shape_id, str) and self.has(shape_id)

    def __bool__(self) -> bool:
        return True  # without it, the truth of a client would be a request
