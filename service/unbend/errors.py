"""Every error unbend raises on purpose, in one tree.

    UnbendError
    ├── MeshError                 the mesh given cannot be used
    │   ├── MeshFormatError       not a format we read
    │   ├── MeshReadError         the file is damaged or incomplete
    │   ├── MeshTooLargeError     it holds more vertices or triangles than allowed
    │   └── MeshGeometryError     it was read, but holds no usable surface
    ├── ParameterError            an argument is out of its range
    │   └── UnsuitedError         it is in its range, but what is there does not allow it
    ├── StoreError                the library's store
    │   ├── NotFoundError         no such record
    │   ├── ChangedError          the record was changed since the caller read it
    │   ├── StoreVersionError     the store was made by another version
    │   ├── StoreFullError        its disk has no room
    │   ├── StoreLostError        its file was removed or replaced
    │   ├── StoreInUseError       another server runs its jobs
    │   └── BackupError           a file is no whole library
    ├── JobError                  why a job did not give a result
    │   ├── JobTimeoutError       it ran longer than allowed
    │   │   └── CallTimeoutError  an answer in place did
    │   ├── JobMemoryError        it asked for more memory than allowed
    │   ├── JobCancelledError     somebody cancelled it
    │   └── WorkerLostError       its process died
    ├── AccessError               the caller may not do this
    │   ├── KeyRequiredError      no API key came with the call
    │   ├── KeyInvalidError       what came is no live key of this library
    │   ├── ScopeError            the key may only read
    │   ├── OriginError           another web site's page sent it
    │   ├── HostError             it was called by a name that is not its own
    │   └── ExposedError          others could reach the service, and nothing asks them for a key
    ├── AddressError              the service cannot listen where it should
    ├── RateLimitError            too many calls in a minute
    ├── UploadTooLargeError       more bytes than the service takes
    ├── UploadTooSlowError        its bytes did not come in time
    ├── TemporaryFullError        the disk for temporary files has no room
    ├── BusyError                 too much at a time
    ├── QueueFullError            too many jobs wait already
    ├── QuotaError                too many jobs of one key wait or run already
    ├── IdempotencyError          another request was sent under the same name
    └── ServiceError              the service answered with a problem, or not at all

`code` is the stable, lower-case name of an error for programs: it stands in failed jobs and in HTTP
problem documents. `advice` says in one sentence what the caller can do.
"""

from __future__ import annotations

from typing import ClassVar


class UnbendError(Exception):
    """Base of all errors of this package."""

    code: ClassVar[str] = "error"
    advice: ClassVar[str] = ""


class MeshError(UnbendError, ValueError):
    """The mesh given cannot be used."""

    code = "mesh_invalid"
    advice = "Check the mesh in a viewer and export it again."


class MeshFormatError(MeshError):
    """The bytes are not of a format we read."""

    code = "mesh_format"
    advice = "Send a single off, obj, ply, stl or glb file."


class MeshReadError(MeshError):
    """The file is of a known format but damaged or incomplete."""

    code = "mesh_read"
    advice = "The file is damaged or incomplete: export it again."


class MeshTooLargeError(MeshError):
    """The file holds, or announces, more vertices or triangles than allowed."""

    code = "mesh_too_large"
    advice = "Simplify the mesh before sending it, or raise UNBEND_MAX_VERTICES and UNBEND_MAX_FACES."


class MeshGeometryError(MeshError):
    """The file was read but holds no usable surface."""

    code = "mesh_geometry"
    advice = "A surface needs finite coordinates and at least one triangle that has an area."


class ParameterError(UnbendError, ValueError):
    """An argument is out of its range."""

    code = "parameter_invalid"
    advice = "Correct the argument named in the message."

    def __init__(self, message: str, *, field: str = "") -> None:
        super().__init__(message)
        self.field = field
        """Where in a request the argument came from, as body.parameters; empty where it came from none."""


class UnsuitedError(ParameterError):
    """An argument is in its range, but the mesh or the library at hand does not allow what is asked."""

    code = "unsuited"
    advice = "Ask it of another shape, or again when the library holds what the message says."


class StoreError(UnbendError):
    """The library's store cannot do what was asked."""

    code = "store"


class NotFoundError(StoreError, LookupError):
    """There is no such record."""

    code = "not_found"
    advice = "Check the identifier; the record may have been deleted."


class ChangedError(StoreError):
    """The record was changed since the caller read it, so that the change would undo another's."""

    code = "precondition_failed"
    advice = "Read the record again, and send the change with its new ETag."


class StoreVersionError(StoreError):
    """The store was made by a version of unbend that this one cannot read."""

    code = "store_version"
    advice = "Open it with the version of unbend that made it, or a newer one."


class StoreFullError(StoreError):
    """The disk that holds the store has no room."""

    code = "store_full"
    advice = "Remove shapes that are not needed, or give the library's disk more room."


class StoreLostError(StoreError):
    """The store's file was removed, or another one was put in its place, while it was open."""

    code = "store_lost"
    advice = "Put the library's file back and restart the server; `unbend restore` replaces a library in use safely."


class StoreInUseError(StoreError):
    """Another server runs the jobs of this library."""

    code = "store_in_use"
    advice = "Stop the other server first, or give this one a library of its own."


class BackupError(StoreError):
    """A file that should be a library, or the backup of one, is not, or is damaged."""

    code = "backup"
    advice = "Take an older backup, or make a new one."


class JobError(UnbendError):
    """A job did not give a result."""

    code = "job_failed"


class JobTimeoutError(JobError):
    """A job ran longer than the service allows."""

    code = "job_timeout"
    advice = "Send a mesh with fewer vertices, ask for fewer samples, or raise UNBEND_JOB_SECONDS."


class CallTimeoutError(JobTimeoutError):
    """An answer in place took longer than the service allows."""

    code = "call_timeout"
    advice = "Ask again with the header Prefer: respond-async, which makes it a job, or raise UNBEND_CALL_SECONDS."


class JobMemoryError(JobError):
    """A job asked for more memory than the service allows."""

    code = "job_memory"
    advice = "Send a mesh with fewer vertices, or raise UNBEND_JOB_MEMORY_MB."


class JobCancelledError(JobError):
    """Somebody cancelled the job."""

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
    """The call needs an API key, and none came with it."""

    code = "key_required"
    advice = "Send the header Authorization: Bearer KEY; `unbend keys create` makes keys."


class KeyInvalidError(AccessError):
    """What came with the call is no live key of this library. It is not said why, so that nothing can be probed."""

    code = "key_invalid"
    advice = "Check the header Authorization: Bearer KEY; the key may have been revoked, or be another library's."


class ScopeError(AccessError):
    """The key may read, and the call writes."""

    code = "scope_insufficient"
    advice = "Use a key made with `unbend keys create --scope write`."


class OriginError(AccessError):
    """A page of another web site sent a write to a service that asks for no key."""

    code = "origin_refused"
    advice = "Name the site in UNBEND_CORS_ORIGINS if it may write, or have the service ask for keys."


class HostError(AccessError):
    """The service was called by a name that it does not know, and asks for no key: another site may lead here."""

    code = "host_refused"
    advice = "Call it by its address or as localhost, name the host in UNBEND_ALLOWED_HOSTS, or make a key."


class ExposedError(AccessError):
    """The service would be reached by others, and nothing would ask them for a key."""

    code = "exposed"
    advice = "Make a key with `unbend keys create`, or say --open if others may read and write."


class AddressError(UnbendError):
    """The service cannot listen at the address it was given."""

    code = "address"
    advice = "Stop what listens there already, or choose another --port."


class RateLimitError(UnbendError):
    """More calls in a minute than the service takes; try again after `retry_after` seconds."""

    code = "rate_limited"
    advice = "Wait as long as Retry-After says and send the request again."

    def __init__(self, message: str, retry_after: int = 1) -> None:
        super().__init__(message)
        self.retry_after = retry_after


class UploadTooLargeError(UnbendError):
    """A request has more bytes than the service takes."""

    code = "upload_too_large"
    advice = "Send less, or raise UNBEND_MAX_UPLOAD_MB for files and UNBEND_MAX_JSON_KB for other requests."


class UploadTooSlowError(UnbendError):
    """The bytes of a request did not come in time."""

    code = "upload_too_slow"
    advice = "Send it again over a better line, or a smaller file."


class TemporaryFullError(UnbendError):
    """The disk for temporary files has no room for a request's body."""

    code = "temporary_full"
    advice = "Give the folder for temporary files (TMPDIR) more room, or send a smaller file."


class BusyError(UnbendError):
    """The service has too much of something at a time; try again after `retry_after` seconds."""

    code = "busy"
    advice = "Wait as long as Retry-After says and send the request again."

    def __init__(self, message: str, retry_after: int = 1) -> None:
        super().__init__(message)
        self.retry_after = retry_after


class QueueFullError(UnbendError):
    """Too many jobs wait already; try again after `retry_after` seconds."""

    code = "queue_full"
    advice = "Wait as long as Retry-After says and send the request again."

    def __init__(self, message: str, retry_after: int = 1) -> None:
        super().__init__(message)
        self.retry_after = retry_after


class QuotaError(UnbendError):
    """The key has its full quota of unfinished jobs; try again after `retry_after` seconds."""

    code = "quota_exceeded"
    advice = "Wait until some of the key's jobs have ended, or cancel them."

    def __init__(self, message: str, retry_after: int = 5) -> None:
        super().__init__(message)
        self.retry_after = retry_after


class IdempotencyError(UnbendError, ValueError):
    """A request was sent with the Idempotency-Key of another one."""

    code = "idempotency_mismatch"
    advice = "Send each request with a key of its own, and the same key only to repeat it as it was."


class ServiceError(UnbendError):
    """The service answered with a problem (RFC 9457), or could not be reached."""

    code = "service"

    def __init__(self, message: str, *, status: int | None = None, problem: dict[str, object] | None = None):
        super().__init__(message)
        self.status = status
        self.problem = problem or {}
