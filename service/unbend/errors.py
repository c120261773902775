"""The errors of unbend, in one tree.

    UnbendError
    ├── MeshError                 the mesh cannot be used
    │   ├── MeshFileError         its file cannot be opened
    │   │   └── MeshMissingError  there is no such file
    │   ├── MeshFormatError       its format is unknown
    │   ├── MeshReadError         the file is damaged or incomplete
    │   ├── MeshTooLargeError     it has more vertices or triangles than allowed
    │   └── MeshGeometryError     it has no usable surface
    ├── ParameterError            an argument is out of its range
    │   ├── UnsuitedError         it is in its range, but the mesh or the library does not allow it
    │   └── ExistsError           a file or a library is there already, and would be replaced
    ├── StoreError                the store of the library fails
    │   ├── StoreUnavailableError  its database does not answer now
    │   │   └── ObjectsUnavailableError  its object store does not answer now, or refuses
    │   │       └── ObjectMissingError   the object store has no such object
    │   ├── ObjectDamagedError    the object store has other bytes than those that were stored
    │   ├── NotFoundError         no such record
    │   ├── ChangedError          the record was changed since the caller read it
    │   ├── StoreVersionError     another version made the store
    │   │   └── StoreOutdatedError  it must be migrated first
    │   ├── StoreUnfinishedError  it is the target of a move that was interrupted
    │   ├── MoveError             a row cannot be moved to another database
    │   ├── StoreFullError        its disk is full
    │   ├── StoreLostError        its file was removed or replaced
    │   ├── StoreInUseError       another server runs its jobs
    │   ├── VectorsMissingError   its database cannot search vectors
    │   └── BackupError           a file is no complete library
    ├── JobError                  a job has no result
    │   ├── JobTimeoutError       it ran longer than allowed
    │   │   └── CallTimeoutError  a request without a job ran too long
    │   ├── JobMemoryError        it needed more memory than allowed
    │   ├── JobCancelledError     it was cancelled
    │   └── WorkerLostError       its process died
    ├── AccessError               the caller may not do this
    │   ├── KeyRequiredError      the request has no API key
    │   ├── KeyInvalidError       the key is not one of this library
    │   ├── ScopeError            the key may only read
    │   ├── OriginError           a page of another website sent the request
    │   ├── HostError             the request names an unknown host
    │   └── ExposedError          the service would be public without keys
    ├── AddressError              the service cannot listen at its address
    ├── RateLimitError            too many requests in a minute
    ├── UploadTooLargeError       the request is too large
    ├── UploadTooSlowError        the request arrived too slowly
    ├── TemporaryFullError        the disk for temporary files is full
    ├── BusyError                 too many requests of one kind at a time
    ├── QueueFullError            too many jobs wait already
    ├── QuotaError                too many jobs of one key wait or run already
    ├── ExtraMissingError         a package of an extra is not installed
    ├── ResultsError              results that were computed elsewhere cannot be used
    ├── IdempotencyError          a different request had the same idempotency key
    └── ServiceError              the service did not respond, or responded with an unknown error

`code` is the stable, lower-case name of an error for programs, in failed jobs and in HTTP problem documents. `advice`
tells the caller in one sentence what to do.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from types import MappingProxyType
from typing import ClassVar, Self, TypeVar


class UnbendError(Exception):
    """Base of all errors of this package."""

    code: ClassVar[str] = "error"
    """The stable, lower-case name of the error, for programs."""
    advice: str = ""
    """A sentence that says what the caller can do; empty if there is no advice."""
    status: int | None = None
    """The status of the response, if a service reported the error to a client."""
    problem: Mapping[str, object] = MappingProxyType({})
    """The problem document (RFC 9457), if a service reported the error to a client."""

    def with_advice(self, advice: str) -> Self:
        """Set the advice of this error, in place of that of its class, and return the error."""
        self.advice = advice
        return self


class MeshError(UnbendError, ValueError):
    """The mesh cannot be used."""

    code = "mesh_invalid"
    advice = "Check the mesh in a viewer and export it again."


class MeshFileError(OSError, MeshError):
    """The file of the mesh cannot be opened. It is also an OSError, with `errno`, `strerror` and `filename`."""

    code = "mesh_file"
    advice = "Check the path, and whether you may read the file."

    def __str__(self) -> str:
        return f"{self.filename}: {self.strerror}" if self.filename else super().__str__()


class MeshMissingError(MeshFileError, FileNotFoundError):
    """There is no such file."""

    code = "mesh_missing"


class MeshFormatError(MeshError):
    """The format of the file is unknown."""

    code = "mesh_format"
    advice = "Send a single off, obj, ply, stl or glb file."


class MeshReadError(MeshError):
    """The file has a known format, but is damaged or incomplete."""

    code = "mesh_read"
    advice = "The file is damaged or incomplete: export it again."


class MeshTooLargeError(MeshError):
    """The file has, or its header announces, more vertices or triangles than allowed."""

    code = "mesh_too_large"
    advice = "Simplify the mesh before sending it, or raise UNBEND_MAX_VERTICES and UNBEND_MAX_FACES."


class MeshGeometryError(MeshError):
    """The file was read, but has no usable surface."""

    code = "mesh_geometry"
    advice = "A surface needs finite coordinates and at least one triangle that has an area."


class ParameterError(UnbendError, ValueError):
    """An argument is out of its range."""

    code = "parameter_invalid"
    advice = "Correct the argument named in the message."

    def __init__(self, message: str, *, field: str = "") -> None:
        super().__init__(message)
        self.field = field
        """The argument, or its place in a request, such as body.parameters; empty if unknown."""


class UnsuitedError(ParameterError):
    """An argument is in its range, but the mesh or the library does not allow it."""

    code = "unsuited"
    advice = "Try another shape, or try again once the library contains what the message names."


class ExistsError(ParameterError):
    """A file or a library is there already, and the caller did not ask to replace it."""

    code = "exists"
    advice = "Name another place, or pass overwrite=True to replace what is there."


class StoreError(UnbendError):
    """The store of the library fails."""

    code = "store"


class StoreUnavailableError(StoreError):
    """The database of the library does not answer now; retry after `retry_after` seconds."""

    code = "store_unavailable"
    advice = "Try again in a few seconds; if it lasts, check the database and the network."

    def __init__(self, message: str, retry_after: int = 2) -> None:
        super().__init__(message)
        self.retry_after = retry_after


class ObjectsUnavailableError(StoreUnavailableError):
    """The object store of the library does not answer now, or refuses; retry after `retry_after` seconds."""

    code = "objects_unavailable"
    advice = "Try again in a few seconds; if it lasts, check the object store, its credentials and the network."


class ObjectMissingError(ObjectsUnavailableError):
    """The object store has no object for a mesh of the library."""

    code = "object_missing"
    advice = "Check the address of the object store, or put the object back from a backup; `unbend sweep` lists all."


class ObjectDamagedError(StoreError):
    """An object has other bytes than those that were stored."""

    code = "object_damaged"
    advice = "Put the object back from a backup of the object store, or remove the shape and send its file again."


class NotFoundError(StoreError, LookupError):
    """There is no such record."""

    code = "not_found"
    advice = "Check the identifier; the record may have been deleted."


class ChangedError(StoreError):
    """The record was changed since the caller read it, so that this change would overwrite another."""

    code = "precondition_failed"
    advice = "Read the record again, and send the change with its new ETag."


class StoreVersionError(StoreError):
    """A later version of unbend made the store."""

    code = "store_version"
    advice = "Open it with the version of unbend that made it, or a newer one."


class StoreOutdatedError(StoreVersionError):
    """The store has the schema of an earlier version, and may not be migrated here."""

    code = "store_outdated"
    advice = "Migrate it once by `unbend migrate`, or let the service do it: UNBEND_MIGRATE=true."


class StoreUnfinishedError(StoreError):
    """The store is the target of a move between databases that was interrupted."""

    code = "store_unfinished"
    advice = "Run the same `unbend migrate-library` again: it goes on where it was."


class MoveError(StoreError):
    """A row cannot be moved to another database: it is damaged, does not fit there, or differs from what is there."""

    code = "move"
    advice = "Correct the row that the message names; then move the library to a new, empty database."


class StoreFullError(StoreError):
    """The disk of the store is full."""

    code = "store_full"
    advice = "Remove shapes that are not needed, or enlarge the library's disk."


class StoreLostError(StoreError):
    """The file of the store was removed or replaced while it was open."""

    code = "store_lost"
    advice = "Put the library's file back and restart the server; `unbend restore` replaces a library in use safely."


class StoreInUseError(StoreError):
    """Another server runs the jobs of this library."""

    code = "store_in_use"
    advice = "Stop the other server first, or give this one a library of its own."


class VectorsMissingError(StoreError):
    """The database of the store cannot search vectors: it lacks the extension pgvector."""

    code = "vectors_missing"
    advice = "Let an administrator of the database install pgvector 0.8 or later, or set UNBEND_SEARCH=memory."


class BackupError(StoreError):
    """A file is damaged, or is no library or backup."""

    code = "backup"
    advice = "Take an older backup, or make a new one."


class JobError(UnbendError):
    """A job has no result."""

    code = "job_failed"


class JobTimeoutError(JobError):
    """A job ran longer than the service allows."""

    code = "job_timeout"
    advice = "Send a mesh with fewer vertices, ask for fewer samples, or raise UNBEND_JOB_SECONDS."


class CallTimeoutError(JobTimeoutError):
    """A request without a job took longer than the service allows."""

    code = "call_timeout"
    advice = (
        "Repeat the request with the header Prefer: respond-async, which makes it a job, or raise UNBEND_CALL_SECONDS."
    )


class JobMemoryError(JobError):
    """A job needed more memory than the service allows."""

    code = "job_memory"
    advice = "Send a mesh with fewer vertices, or raise UNBEND_JOB_MEMORY_MB."


class JobCancelledError(JobError):
    """The job was cancelled."""

    code = "job_cancelled"
    advice = "Submit the mesh again if it is still wanted."


class WorkerLostError(JobError):
    """The process that ran the job died, on every attempt."""

    code = "worker_lost"
    advice = "The mesh may need more memory than the machine has; if it is small, please report it."


class AccessError(UnbendError):
    """The caller may not do this."""

    code = "access"


class KeyRequiredError(AccessError):
    """The request needs an API key, and has none."""

    code = "key_required"
    advice = "Send the header Authorization: Bearer KEY; `unbend keys create` makes keys."


class KeyInvalidError(AccessError):
    """The key of the request is not valid for this library. The message hides why, so that keys cannot be probed."""

    code = "key_invalid"
    advice = "Check the header Authorization: Bearer KEY; the key may be revoked, or belong to another library."


class ScopeError(AccessError):
    """The key may only read, and the request writes."""

    code = "scope_insufficient"
    advice = "Use a key made with `unbend keys create --scope write`."


class OriginError(AccessError):
    """A page of another website sent a write to a service without keys."""

    code = "origin_refused"
    advice = "Add the site to UNBEND_CORS_ORIGINS if it may write, or create a key, so that the service needs keys."


class HostError(AccessError):
    """A request to a service without keys names an unknown host: a website may have sent it by DNS rebinding."""

    code = "host_refused"
    advice = "Use the address or localhost, add the host to UNBEND_ALLOWED_HOSTS, or create a key."


class ExposedError(AccessError):
    """The service would be public without keys."""

    code = "exposed"
    advice = "Create a key with `unbend keys create`, or use --open if everybody may read and write."


class AddressError(UnbendError):
    """The service cannot listen at its address."""

    code = "address"
    advice = "Stop the program that listens there, or choose another --port."


class RateLimitError(UnbendError):
    """Too many requests in a minute; retry after `retry_after` seconds."""

    code = "rate_limited"
    advice = "Wait for the seconds in Retry-After, and send the request again."

    def __init__(self, message: str, retry_after: int = 1) -> None:
        super().__init__(message)
        self.retry_after = retry_after


class UploadTooLargeError(UnbendError):
    """A request is larger than the service allows."""

    code = "upload_too_large"
    advice = "Send less, or raise UNBEND_MAX_UPLOAD_MB for files and UNBEND_MAX_JSON_KB for other requests."


class UploadTooSlowError(UnbendError):
    """A request arrived more slowly than the service allows."""

    code = "upload_too_slow"
    advice = "Send it again over a faster connection, or send a smaller file."


class TemporaryFullError(UnbendError):
    """The disk for temporary files is full."""

    code = "temporary_full"
    advice = "Free space in the folder for temporary files (TMPDIR), or send a smaller file."


class BusyError(UnbendError):
    """The service is at a limit; retry after `retry_after` seconds."""

    code = "busy"
    advice = "Wait for the seconds in Retry-After, and send the request again."

    def __init__(self, message: str, retry_after: int = 1) -> None:
        super().__init__(message)
        self.retry_after = retry_after


class QueueFullError(UnbendError):
    """Too many jobs wait already; retry after `retry_after` seconds."""

    code = "queue_full"
    advice = "Wait for the seconds in Retry-After, and send the request again."

    def __init__(self, message: str, retry_after: int = 1) -> None:
        super().__init__(message)
        self.retry_after = retry_after


class QuotaError(UnbendError):
    """The key has its full quota of unfinished jobs; retry after `retry_after` seconds."""

    code = "quota_exceeded"
    advice = "Wait until some of the key's jobs have ended, or cancel them."

    def __init__(self, message: str, retry_after: int = 5) -> None:
        super().__init__(message)
        self.retry_after = retry_after


class ExtraMissingError(UnbendError, ImportError):
    """A package is not installed that only an extra of unbend needs."""

    code = "extra_missing"
    advice = "Install the extra that the message names."


class ResultsError(UnbendError, ValueError):
    """Results that were computed elsewhere are damaged, or are of another version of the algorithm."""

    code = "results"
    advice = "Compute the results again with this version of unbend."


class IdempotencyError(UnbendError, ValueError):
    """A request repeats the Idempotency-Key of a different request."""

    code = "idempotency_mismatch"
    advice = "Use a new key for each request, and repeat a key only with the same request."


class ServiceError(UnbendError):
    """The service could not be reached, or responded with an error that has no class of its own."""

    code = "service"
    advice = "Check the address, and whether the service runs there."


def reported(
    code: object,
    message: str,
    *,
    advice: str = "",
    status: int | None = None,
    problem: Mapping[str, object] | None = None,
    unknown: type[UnbendError] = ServiceError,
) -> UnbendError:
    """Return the error that a service reported, of the class that has its code; of `unknown` if no class has it."""
    kinds = {kind.code: kind for kind in subclasses(UnbendError) if kind is not UnbendError}
    error = kinds.get(str(code), unknown)(message)
    error.advice = advice or error.advice
    error.status = status
    error.problem = MappingProxyType(dict(problem or {}))
    return error


T = TypeVar("T", bound=UnbendError)


def subclasses(base: type[T]) -> Iterator[type[T]]:
    """Yield an error class and all classes derived from it."""
    yield base
    for kind in base.__subclasses__():
        yield from subclasses(kind)


def check_choice(name: str, value: object, choices: Collection[str]) -> None:
    """Raise ParameterError if an argument is not one of its choices."""
    if value not in choices:
        raise ParameterError(f"{name} must be one of {', '.join(choices)}, not {value!r}")
