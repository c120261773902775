"""schemathesis against the HTTP contract with many requests, with and without keys.

    python -m benchmarks.service.contract [EXAMPLES] [STEPS] [SEED]

Makes up EXAMPLES requests (200 by default) for each operation in each way of making them up, and as many sequences of
up to STEPS (30) that go on with what was answered; another seed each time unless one is given. Needs the extra `test`.
Writes "contract" of docs/reliability.md, and ends with an error where anything was found.
"""

from __future__ import annotations

import importlib.metadata
import secrets
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory

from benchmarks.common import ROOT, table, write_section
from tests.support.conformance import CHECK_NAMES, PHASES, Report, run
from tests.support.server import Server
from unbend.library import Library

PAGE = ROOT / "docs" / "reliability.md"
EXAMPLES, STEPS = 200, 30
HOURS = 6 * 3600.0


def main() -> None:
    given = [int(text) for text in sys.argv[1:]]
    examples, steps, seed = given + [EXAMPLES, STEPS, secrets.randbelow(2**31)][len(given) :]
    start = time.perf_counter()
    with TemporaryDirectory(prefix="unbend-contract-") as name:
        reports = {
            "open": report_on(Path(name) / "open", examples, steps, seed, closed=False),
            "with keys": report_on(Path(name) / "closed", examples, steps, seed, closed=True),
        }
    write_section(PAGE, "contract", text(reports, examples, steps, seed, time.perf_counter() - start))
    for report in reports.values():
        if report.failed or set(report.phases.values()) != {"success"}:
            sys.exit(report.output)


def report_on(folder: Path, examples: int, steps: int, seed: int, *, closed: bool) -> Report:
    with Server(folder / "server") as server:
        key = None
        if closed:
            with Library(str(server.library)) as library:
                _, key = library.keys.create("schemathesis", "write")
        return run(server.url, folder, examples=examples, steps=steps, seed=seed, key=key, timeout=HOURS)


def text(reports: dict[str, Report], examples: int, steps: int, seed: int, seconds: float) -> str:
    names = list(reports)
    operations = sorted(next(iter(reports.values())).operations, key=lambda label: label.split()[::-1])
    by_operation = [[f"`{label}`", *(requests(reports[name], label) for name in names)] for label in operations]
    others = [
        sum(count for (_, label), count in each.cases.items() if label not in each.operations)
        for each in reports.values()
    ]
    by_operation += [["methods that are not there", *(f"{count:,}" for count in others)]]
    by_operation += [["**all**", *(f"**{sum(each.cases.values()):,}**" for each in reports.values())]]
    checks = [[f"`{name}`", *(f"{each.checks[name]:,}" for each in reports.values())] for name in sorted(CHECK_NAMES)]
    rows = [
        ["failures", *(len(each.failed) for each in reports.values())],
        ["requests of the longest sequence that went on with answers", *(each.longest for each in reports.values())],
        ["links that led somewhere", *(len(each.followed) for each in reports.values())],
    ]
    phases = ", ".join(PHASES)
    return f"""schemathesis {importlib.metadata.version("schemathesis")} generated valid and invalid requests from the OpenAPI document, sent them to a server on loopback, and checked each response against the document, with all of its checks and in all of its phases ({phases}): {examples} examples an operation, {examples} sequences of up to {steps} requests, seed {seed}, {seconds / 60:.0f} minutes. Exceptions and their reasons are in `tests/support/schemathesis.toml`.

{table(["", *names], rows)}

Requests, and in brackets those with a 2xx response:

{table(["operation", *names], by_operation)}

Checks made:

{table(["check", *names], checks)}"""  # noqa: E501


def requests(report: Report, label: str) -> str:
    sent = sum(report.cases[phase, label] for phase in PHASES)
    return f"{sent:,} ({report.accepted[label]:,})"


if __name__ == "__main__":
    main()
