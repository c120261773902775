"""Runs of schemathesis against a server, and their reports."""

from __future__ import annotations

import json
import subprocess
import sys
import tomllib
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import httpx
from schemathesis.checks import CHECKS, load_all_checks

from tests.support.server import without_settings

SUPPORT = Path(__file__).parent
PHASES = ("examples", "coverage", "fuzzing", "stateful")
load_all_checks()  # without this call, the registry has only one check
CHECK_NAMES = frozenset(CHECKS.get_all_names())


@dataclass
class Report:
    """The requests and findings of a run."""

    output: str
    operations: frozenset[str]
    """The operations of the document that the configuration does not exclude, such as `GET /v1/shapes`."""
    phases: dict[str, str] = field(default_factory=dict)
    """The outcome of each phase."""
    cases: Counter[tuple[str, str]] = field(default_factory=Counter)
    """Number of requests by phase and operation, including methods that the document lacks."""
    accepted: Counter[str] = field(default_factory=Counter)
    """Number of requests with a 2xx response, by operation."""
    checks: Counter[str] = field(default_factory=Counter)
    """Number of checks made, by name."""
    failed: list[str] = field(default_factory=list)
    followed: set[str] = field(default_factory=set)
    """Links that took an id from an earlier response."""
    longest: int = 0
    """Length of the longest sequence of linked requests."""


def run(
    url: str,
    folder: Path,
    *,
    examples: int,
    steps: int,
    seed: int | None,
    key: str | None = None,
    timeout: float = 3600,
) -> Report:
    """Test a server with schemathesis against the OpenAPI document that the server serves.

    Parameters
    ----------
    url : str
    folder : Path
        Folder for the files of the run.
    examples : int
        Number of requests generated for each operation, and number of sequences.
    steps : int
        Largest number of requests in a sequence.
    seed : int, optional
        Seed of the generated requests, which are reproducible except for ids from responses; None for a random seed.
    key : str, optional
        A key with write scope, if the server's library has keys: then every operation must require a key.
    """
    document = httpx.get(f"{url}/openapi.json").raise_for_status().json()
    if key:
        _close(document)
    (folder / "openapi.json").write_text(json.dumps(document))
    settings = (SUPPORT / "schemathesis.toml").read_text()
    (folder / "schemathesis.toml").write_text(f"{settings}\n[phases.stateful]\nmax-steps = {steps}\n")
    events = folder / "events.ndjson"
    command = [
        sys.executable, "-m", "schemathesis.cli", "--config-file", str(folder / "schemathesis.toml"), "run",
        str(folder / "openapi.json"), "--url", url, "--max-examples", str(examples), "--phases", ",".join(PHASES),
        "--report", "ndjson", "--report-ndjson-path", str(events), "--no-color",
    ]  # fmt: skip
    command += ["--seed", str(seed)] if seed is not None else []
    command += ["--header", f"Authorization: Bearer {key}"] if key else []
    done = subprocess.run(
        command,
        check=False,
        cwd=folder,
        env=without_settings(PYTHONPATH=_path()),
        capture_output=True,
        text=True,
        timeout=timeout,
    )
    report = Report(done.stdout + done.stderr, _operations(document, tomllib.loads(settings)))
    for kind, event in _events(events):
        _READERS.get(kind, _ignore)(report, event)
    return report


def _close(document: dict[str, Any]) -> None:
    """Make keys mandatory in a document, as they are for a library with keys."""
    for operations in document["paths"].values():
        for operation in operations.values():
            if "security" in operation:
                operation["security"].remove({})


def _operations(document: dict[str, Any], settings: dict[str, Any]) -> frozenset[str]:
    excluded = {rule["include-path"] for rule in settings["operations"] if not rule.get("enabled", True)}
    return frozenset(
        f"{method.upper()} {path}"
        for path, found in document["paths"].items()
        for method in found
        if path not in excluded
    )


def _path() -> str:
    return ":".join(dict.fromkeys([str(SUPPORT), *filter(None, sys.path)]))


def _events(path: Path) -> Iterator[tuple[str, dict[str, Any]]]:
    if path.exists():
        with path.open() as lines:
            for line in lines:
                yield from json.loads(line).items()


def _ignore(_report: Report, _event: dict[str, Any]) -> None:
    pass


def _phase(report: Report, event: dict[str, Any]) -> None:
    report.phases[event["phase"]["name"]] = event["status"]


def _scenario(report: Report, event: dict[str, Any]) -> None:
    recorder = event["recorder"]
    lengths: dict[str, int] = {}
    for case_id, case in recorder.get("cases", {}).items():  # an operation without examples has no cases
        label = f"{case['value']['method']} {case['value']['path']}"
        answered = recorder["interactions"].get(case_id)
        if answered is None:
            continue
        report.cases[event["phase"], label] += 1
        response = answered.get("response") or {"status_code": 0}
        taken = 200 <= response["status_code"] < 300
        report.accepted[label] += taken
        lengths[case_id] = 1
        if case.get("is_transition_applied"):
            lengths[case_id] += lengths.get(case.get("parent_id", ""), 0)
            if taken:
                report.followed.add(case["transition"]["id"])
        report.longest = max(report.longest, lengths[case_id] if taken else 0)
        for check in recorder["checks"].get(case_id, []):
            report.checks[check["name"]] += 1
            if check["status"] != "success":
                report.failed.append(f"{label}: {check['name']}")


_READERS = {"PhaseFinished": _phase, "ScenarioFinished": _scenario}
