"""Sources of settings, their precedence, and invalid settings with which a server does not start."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

import pytest
from click.testing import CliRunner

from tests.support.server import Server
from unbend.api import Settings
from unbend.api.server.configuration import read_settings
from unbend.cli import main
from unbend.errors import ParameterError
from unbend.library.storage.database import shown_url

OTHERS = {  # a value for each setting that differs from its default
    "library": "other.db", "migrate": False, "objects": "file:///srv/meshes", "workers": 3, "search": "memory",
    "max_upload_mb": 5, "max_queued": 7, "job_seconds": 1.5,
    "job_memory_mb": 2048, "drain_seconds": 0, "log_format": "json", "traces": "http://localhost:4318", "open": True,
    "max_arriving_mb": 6, "transfer_seconds": 8.5, "stall_seconds": 2.5, "head_seconds": 3.5, "max_connections": 99,
    "max_waiting": 11, "max_vertices": 12, "max_faces": 13,
    "backup_folder": str(Path(__file__).parent), "backup_hours": 1.5, "backup_keep": 3,
    "webhook_hosts": "example.org", "webhook_secret": "sixteen characters",
    "call_seconds": 6.5, "root_path": "/a/b", "job_history": 21, "job_days": 1.5,
    "reserve_mb": 30, "max_json_kb": 14, "max_answering_mb": 15,
    "trusted_proxies": "10.0.0.0/8, 127.0.0.1", "allowed_hosts": "unbend",
    "requests_per_minute": 9, "local_signatures": False, "cors_origins": "https://example.org, http://[::1]:8080",
}  # fmt: skip


@pytest.fixture(autouse=True)
def clean_environment(monkeypatch, tmp_path):
    """Remove settings from the environment, and change to an empty folder for the default library."""
    for name in os.environ:
        if name.upper().startswith("UNBEND_"):
            monkeypatch.delenv(name)
    monkeypatch.chdir(tmp_path)


def refusal(*arguments: object, **variables: object) -> str:
    """Run `unbend serve`, which must not start, and return its message."""
    environment = {name: str(value) for name, value in variables.items()}
    done = CliRunner(env=environment).invoke(main, ["serve", "--port", "0", *map(str, arguments)])
    assert done.exit_code == 1, done.output
    assert isinstance(done.exception, SystemExit), done.exc_info  # not a traceback
    assert done.stderr.startswith("unbend: ")
    return done.stderr.splitlines()[0].removeprefix("unbend: ")


def toml(folder: Path, text: str) -> Path:
    path = folder / "settings.toml"
    path.write_text(text)
    return path


def literal(value: object) -> str:
    return str(value).lower() if isinstance(value, bool) else f'"{value}"' if isinstance(value, str) else str(value)


def test_every_setting_is_read_from_the_environment_and_from_a_file(monkeypatch, tmp_path):
    assert set(OTHERS) == set(Settings.model_fields)
    defaults = Settings().model_dump()
    assert all(defaults[name] != value for name, value in OTHERS.items())
    file = toml(tmp_path, "\n".join(f"{name} = {literal(value)}" for name, value in OTHERS.items()))
    assert read_settings({}, file).model_dump() == OTHERS
    for name, value in OTHERS.items():
        monkeypatch.setenv(f"UNBEND_{name.upper()}", str(value))
    assert Settings().model_dump() == OTHERS


def test_options_override_the_environment_which_overrides_the_file(monkeypatch, tmp_path):
    file = toml(tmp_path, "workers = 2\nmax_queued = 2\nmax_upload_mb = 2")
    monkeypatch.setenv("UNBEND_WORKERS", "3")
    monkeypatch.setenv("unbend_max_queued", "3")
    found = read_settings({"workers": 4}, file)
    assert (found.workers, found.max_queued, found.max_upload_mb) == (4, 3, 2)
    assert found.job_seconds == 600
    assert isinstance(found, Settings)


def test_a_server_reads_its_settings_from_a_file(tmp_path):
    file = toml(tmp_path, "workers = 7\nmax_queued = 5\njob_seconds = 3.5\nlog_format = 'json'")
    with Server(tmp_path, workers=1, ready=False, config=file, job_seconds=60) as server, server.http() as http:
        reported = http.get("/v1/capacity").json()
        assert (reported["workers"], reported["max_queued"]) == (1, 5)
        assert '"message"' in server.log.read_text()


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("workers = 'four'", ["workers is 'four'", "valid integer"]),
        ("workers = '4'", ["workers is '4'", "valid integer"]),
        ("workers = true", ["workers is True", "valid integer"]),
        ("workers = 0", ["workers is 0", "should be at least 1"]),
        ("open = 1", ["open is 1", "valid boolean"]),
        ("library = 5", ["library: ", "valid string"]),
        ("job_seconds = inf", ["job_seconds is inf", "finite"]),
        ("drain_seconds = nan", ["drain_seconds is nan", "finite"]),
        ("wrokers = 4", ["wrokers is not a setting; did you mean workers?"]),
        ("[server]\nworkers = 4", ["server is not a setting"]),
        ("log_format = 'xml'", ["log_format is 'xml'", "'text' or 'json'"]),
        ("max_upload_mb = 1024\njob_memory_mb = 1024", ["job_memory_mb is 1024: ", "more than {file}: max_upload_mb"]),
        ("workers = 0\nwrokers = 1\nopen = 1", ["wrokers is not", "open is 1"]),
        ("workers 4", ["not TOML", "line 1"]),
        ("workers = 1\nworkers = 2", ["not TOML", "overwrite"]),
    ],
)
def test_an_error_in_a_settings_file_names_the_file_and_the_key(tmp_path, text, words):
    file = toml(tmp_path, text)
    said = refusal("--config", file)
    assert said.startswith(f"{file}: ")
    for word in words:
        assert word.format(file=file) in said


def test_an_unreadable_settings_file_is_named(tmp_path):
    assert refusal("--config", tmp_path / "none.toml").startswith(f"{tmp_path}/none.toml: ")
    assert refusal(UNBEND_CONFIG=tmp_path).startswith(f"{tmp_path}: ")
    (tmp_path / "latin.toml").write_bytes(b'library = "\xe4.db"')
    assert "latin.toml: not TOML" in refusal("--config", tmp_path / "latin.toml")


@pytest.mark.parametrize(
    ("name", "value", "word"),
    [
        ("UNBEND_WORKERS", "four", "'four': input should be a valid integer"),
        ("unbend_workers", "999", "'999': input should be less than or equal to 256"),
        ("UNBEND_JOB_SECONDS", "inf", "finite"),
        ("UNBEND_JOB_SECONDS", "nan", "finite"),
        ("UNBEND_DRAIN_SECONDS", "1e999", "finite"),
        ("UNBEND_JOB_MEMORY_MB", "9" * 30, "less than or equal"),
        ("UNBEND_REQUESTS_PER_MINUTE", "9" * 400, "less than or equal"),
        ("UNBEND_LIBRARY", "", "at least 1 character"),
        ("UNBEND_CORS_ORIGINS", "*, https://example.org", "'*' means all websites"),
        ("UNBEND_CORS_ORIGINS", "https://Example.org", "as browsers send it"),
        ("UNBEND_CORS_ORIGINS", "https://example.org:443", "as browsers send it"),
        ("UNBEND_CORS_ORIGINS", "http://example.org:70000", "as browsers send it"),
        ("UNBEND_CORS_ORIGINS", "https://example.org/", "as browsers send it"),
        ("UNBEND_TRACES", "localhost:4318", "an address such as"),
        ("UNBEND_TRACES", "http://:4318", "an address such as"),
    ],
)
def test_an_invalid_environment_variable_is_named(name, value, word):
    said = refusal(**{name: value})
    assert said.startswith(name)
    assert word in said


def test_contradicting_settings_are_both_named_with_their_source(tmp_path):
    file = toml(tmp_path, "max_upload_mb = 2048")
    said = refusal("--config", file, UNBEND_JOB_MEMORY_MB=1500)
    assert said.startswith("UNBEND_JOB_MEMORY_MB is '1500': ")
    assert f"more than {file}: max_upload_mb," in said


@pytest.mark.parametrize(
    ("name", "meant"),
    [
        ("UNBEND_WORKRES", "UNBEND_WORKERS"),
        ("UNBEND_CORS_ORIGIN", "UNBEND_CORS_ORIGINS"),
        ("unbend_max_upload", "UNBEND_MAX_UPLOAD_MB"),
        ("UNBEND_HOST", None),
        ("UNBEND_PORT", None),
    ],
)
def test_an_unknown_variable_is_refused_with_the_nearest_setting(name, meant):
    assert refusal(**{name: "8000"}) == f"{name} is not a setting" + (f"; did you mean {meant}?" if meant else "")


def test_variables_that_are_not_settings_of_the_server_are_ignored(monkeypatch):
    for name, value in {
        "UNBEND_API_KEY": "unbend_a_b",
        "UNBEND_CONFIG": "read by the command",
        "UNBEND_REQUIRE_SHARED": "1",
        "UNBEND_REQUIRE_BROWSER": "1",
        "UNBEND_REQUIRE_POSTGRES": "1",
        # Kubernetes sets these variables for services named unbend and unbend-web.
        "UNBEND_SERVICE_HOST": "10.0.0.1",
        "UNBEND_SERVICE_PORT": "8000",
        "UNBEND_SERVICE_PORT_HTTP": "8000",
        "UNBEND_PORT": "tcp://10.0.0.1:8000",
        "UNBEND_PORT_8000_TCP": "tcp://10.0.0.1:8000",
        "UNBEND_WEB_PORT_8000_TCP_ADDR": "10.0.0.1",
    }.items():
        monkeypatch.setenv(name, value)
    assert read_settings({}).max_queued == 10_000


@pytest.mark.parametrize(
    ("library", "word"),
    [
        ("nowhere/a.db", "there is no folder nowhere"),
        (".", ". is a folder"),
        (":memory:", "in a file"),
        ("sqlite://", "in a file"),
        ("sqlite:///nowhere/a.db", "there is no folder nowhere"),
        ("://", "neither a path nor"),
    ],
)
def test_an_impossible_library_path_is_refused_with_its_source(tmp_path, library, word):
    for said, where in [
        (refusal("--library", library, UNBEND_LIBRARY="a.db"), "--library"),
        (refusal(UNBEND_LIBRARY=library), "UNBEND_LIBRARY"),
        (refusal("--config", toml(tmp_path, f'library = "{library}"')), f"{tmp_path}/settings.toml: library"),
    ]:
        assert said == f"{where}: the library cannot be opened: {said.rpartition('opened: ')[2]}"
        assert word in said


@pytest.fixture
def unprivileged_user():
    """Run the test as a user to whom file permissions apply."""
    refusal("--library", ":memory:")  # imports all modules while the user may still read them
    user = os.geteuid()
    if user == 0:
        os.seteuid(65534)
    yield
    os.seteuid(user)


def test_a_read_only_library_is_refused(unprivileged_user):
    with tempfile.TemporaryDirectory() as name:
        library = Path(name) / "a.db"
        library.touch(0o444)
        assert refusal("--library", library).endswith(f"{library} cannot be written")
        Path(name).chmod(0o555)
        assert refusal("--library", library).endswith(f"the folder {name} cannot be written")
        Path(name).chmod(0o000)
        assert "Permission denied" in refusal("--library", library)
        Path(name).chmod(0o755)


def test_messages_hide_passwords():
    assert "secret" not in refusal("--library", "nothing://user:secret@host/name")
    assert shown_url("postgresql://user:secret@host/name") == "postgresql://user:***@host/name"
    assert "secret" not in refusal(UNBEND_TRACES="ftp://user:secret@host")


def test_an_invalid_setting_raises_parameter_error():
    with pytest.raises(ParameterError, match="--workers is 0"):
        read_settings({"workers": 0})
