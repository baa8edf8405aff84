#!/usr/bin/env python3
"""Put small faults into the code, one at a time, and see whether the tests notice.

Of each module the same faults are drawn each time, so that two runs can be compared. A fault that
no test notices is printed with its line: it wants a test, or a line in ``equivalent.toml`` with the
reason why it changes nothing that anybody could see.

    .ci/mutants.py                          all modules, 15 faults each (hours)
    .ci/mutants.py bus/link/session c/tactile_link --count 30
"""

import argparse
import ast
import json
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import tomllib
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass, replace
from itertools import pairwise
from pathlib import Path
from queue import Queue

ROOT = Path(__file__).resolve().parent.parent
EQUIVALENT = Path(__file__).with_name("equivalent.toml")
COUNT = 15
"""Number of faults per module."""
CONSTANTS = 3
"""Number of faults of which one at most is another constant."""
LINKS = (
    "test_link_edges test_link_credit test_link_capabilities test_link_notes test_link_estop "
    "test_link_states test_link_faults test_mock_bus test_bus_follower test_bus_spectrum "
    "test_bus_estops test_bus_bad_links test_bus_guards contract"
)
HOST = (
    "test_server_supervision test_estop_model test_server_owners test_server_reloading "
    "test_server_host test_server_tasks"
)
AMPLIFIER = (
    "test_c_amplifier test_c_amplifier_links test_c_amplifier_streams test_protocol_vectors_c "
    "test_protocol_agreement"
)
TESTS = {
    "bus/link/session": LINKS,
    "bus/link/stream": LINKS,
    "bus/link/link_bus": LINKS,
    "server/playing": HOST,
    "server/decoding": "test_decoding test_server_bad_input test_server",
    "estop/latch": f"test_latch test_estop_process {HOST}",
    "estop/process": f"test_estop_process test_estop_desk {HOST}",
    "rendering/limiter": "test_limiter test_travel test_renderer test_playback",
    "rendering/travel": "test_travel test_limiter",
    "rendering/free_tip": "test_travel test_strength",
    "rendering/contact": "test_contact test_renderer",
    "rendering/equalizer": "test_equalizer test_display_drive test_renderer",
    "rendering/renderer": "test_renderer test_playback test_spectrum",
    "rendering/skin_stretch": "test_stretch test_stretch_in_time test_strength",
    "tracking/tracker": "test_tracking test_tracking_clients",
    "texture/surface": "test_texture test_texture_envelope test_relief test_library",
    "texture/measures": "test_measures test_fitting",
    "texture/fitting": "test_fitting test_cli_fit",
    "texture/perception": "test_perception",
    "texture/formats/level_model": "test_level_models",
    "texture/power_laws": "test_power_laws test_shear",
    "study/criteria": "test_study_pieces test_study test_study_running",
    "study/load_fit": "test_load_fit",
    "study/sweep": "test_study_pieces test_study test_study_running",
    "bus/correlations": "test_correlations test_bus_guards",
    "bus/amplifier_guards": "test_bus_guards",
    "c/tactile_correlator": "test_protocol_correlation test_protocol_vectors_c test_c_amplifier",
    "c/tactile_amplifier": AMPLIFIER,
    "c/tactile_config": "test_protocol_config test_c_amplifier",
    "c/tactile_link": AMPLIFIER,
    "c/tactile_player": AMPLIFIER,
    "c/tactile_reports": AMPLIFIER,
}
"""Tests that are to notice a fault in a module, the quickest first."""


@dataclass(frozen=True)
class Mutant:
    """A fault: what stands in place of some characters of a file."""

    module: str
    line: int
    source: str
    old: str
    begin: int
    end: int
    text: str
    nth: int = 1
    """Number of the mutation among those that make the same replacement in lines of the same
    words."""

    @property
    def key(self) -> str:
        """Name that tells it from others of the module, wherever the line has moved."""
        change = f"{self.old.strip()} -> {self.text.strip() or 'nothing'}"
        nth = f" #{self.nth}" if self.nth > 1 else ""
        return f"{self.source.strip()} [{change}]{nth}"


# What may be put into Python

COMPARISONS: dict[type[ast.cmpop], tuple[str, ...]] = {
    ast.Lt: ("<", "<=", ">="), ast.LtE: ("<=", "<", ">"), ast.Gt: (">", ">=", "<="),
    ast.GtE: (">=", ">", "<"), ast.Eq: ("==", "!="), ast.NotEq: ("!=", "=="),
    ast.Is: ("is", "is not"), ast.IsNot: ("is not", "is"), ast.In: ("in", "not in"),
    ast.NotIn: ("not in", "in"),
}  # fmt: skip
"""Spelling of each operator, and the operators that stand in its place."""
OPERATIONS: dict[type[ast.operator], tuple[str, ...]] = {
    ast.Add: ("+", "-"), ast.Sub: ("-", "+"), ast.Mult: ("*", "/"), ast.Div: ("/", "*"),
    ast.FloorDiv: ("//", "*"), ast.Mod: ("%", "+"), ast.Pow: ("**", "*"), ast.BitAnd: ("&", "|"),
    ast.BitOr: ("|", "&"), ast.LShift: ("<<", ">>"), ast.RShift: (">>", "<<"),
}  # fmt: skip


Place = tuple[int, int, str, bool]
"""Bytes of a file from one to before another, what to put there, and whether that is a constant."""


def places_in_python(text: str) -> Iterator[Place]:
    """Yield where a module can be changed; the wording of errors and logs is left out."""
    data = text.encode()
    starts = [0]
    for line in data.splitlines(keepends=True):
        starts.append(starts[-1] + len(line))

    def span(node: ast.expr | ast.stmt) -> tuple[int, int]:
        assert node.end_lineno is not None
        assert node.end_col_offset is not None
        begin = starts[node.lineno - 1] + node.col_offset
        return begin, starts[node.end_lineno - 1] + node.end_col_offset

    def between(left: ast.expr, right: ast.expr, old: str, *others: str) -> Iterator[Place]:
        begin, end = span(left)[1], span(right)[0]
        gap = data[begin:end].decode()
        if re.fullmatch(rf"[\s()\\]*{re.escape(old)}[\s()\\]*", gap):
            yield from ((begin, end, gap.replace(old, new, 1), False) for new in others)

    def here(node: ast.AST) -> Iterator[Place]:
        match node:
            case ast.Compare(left=left, ops=ops, comparators=rest):
                for a, op, b in zip([left, *rest], ops, rest, strict=False):
                    yield from between(a, b, *COMPARISONS[type(op)])
            case ast.BinOp(left=left, op=operation, right=right):
                yield from between(left, right, *OPERATIONS.get(type(operation), ("",)))
            case ast.BoolOp(op=joint, values=values):
                old, new = ("and", "or") if isinstance(joint, ast.And) else ("or", "and")
                for a, b in pairwise(values):
                    yield from between(a, b, old, new)
            case ast.UnaryOp(op=ast.Not() | ast.USub(), operand=operand):
                yield span(node)[0], span(operand)[0], "", False
            case ast.Constant(value=bool() as value):
                yield *span(node), str(not value), True
            case ast.Constant(value=int() as value):
                yield *span(node), str(value + 1), True
            case ast.Constant(value=float() as value):
                yield *span(node), repr(0.75 * value if value else 1.0), True
            case ast.Expr(value=ast.Call() | ast.Await()) | ast.AugAssign():
                yield *span(node), "pass", False
        if isinstance(node, ast.If | ast.IfExp | ast.While):
            begin, end = span(node.test)
            yield begin, end, f"(not ({data[begin:end].decode()}))", False

    def walk(node: ast.AST) -> Iterator[Place]:
        match node:
            case ast.Raise() | ast.Assert() | ast.Expr(value=ast.Constant()):
                return
            case ast.Expr(value=ast.Call(func=ast.Attribute(value=ast.Name(id="log" | "logger")))):
                return
        yield from here(node)
        annotations = {getattr(node, "annotation", None), getattr(node, "returns", None)}
        for child in ast.iter_child_nodes(node):
            if child not in annotations:
                yield from walk(child)

    return walk(ast.parse(text))


# What may be put into C

C_CHANGES = {
    r"(?<![<>=!-])<(?![<=])": ("<=", ">="), r"(?<![<>=!-])>(?![>=])": (">=", "<="),
    r"<=": ("<", ">"), r"(?<!-)>=": (">", "<"), r"==": ("!=",), r"!=": ("==",), r"&&": ("||",),
    r"\|\|": ("&&",), r"(?<=[\w)\]] )\+(?= [\w(])": ("-",), r"(?<=[\w)\]] )-(?= [\w(])": ("+",),
    r"(?<=[\w)\]] )\*(?= [\w(])": ("/",), r"(?<=[\w)\]] )%(?= [\w(])": ("+",),
    r"(?<=return )true": ("false",), r"(?<=return )false": ("true",), r"\+\+": ("--",),
    r"\+=": ("-=",), r"-=": ("+=",),
}  # fmt: skip
C_CONSTANT = r"(?<![\w.])(?:0|[1-9]\d*)u?(?![\w.])"


def places_in_c(text: str) -> Iterator[Place]:
    """Yield where a C file can be changed, outside comments, strings and the preprocessor."""
    blank = re.compile(r'/\*.*?\*/|"(?:\\.|[^"\\])*"|^[ \t]*#.*?$', re.DOTALL | re.MULTILINE)
    code = blank.sub(lambda found: re.sub(r"[^\n]", " ", found[0]), text)
    for pattern, others in C_CHANGES.items():
        for match in re.finditer(pattern, code):
            yield from ((*match.span(), new, False) for new in others)
    for match in re.finditer(C_CONSTANT, code):
        number = match[0].removesuffix("u")
        yield *match.span(), match[0].replace(number, str(int(number) + 1)), True


# The sample


def path_of(module: str) -> Path:
    """Return a module's file below the root."""
    if module.startswith("c/"):
        return Path("firmware_protocol", module).with_suffix(".c")
    return Path("tactile", module).with_suffix(".py")


def drawn(module: str, count: int) -> list[Mutant]:
    """Return the faults of a module, always the same ones for a count or a smaller one."""
    data = (ROOT / path_of(module)).read_bytes()
    if module.startswith("c/"):
        found = sorted(places_in_c(data.decode("latin-1")))  # as many characters as bytes
    else:
        found = sorted(places_in_python(data.decode("utf-8")))
    lines = data.decode("utf-8").splitlines()
    every, keys = list[tuple[Mutant, bool]](), Counter[str]()
    for begin, end, new, constant in found:
        line, old = data[:begin].count(b"\n"), data[begin:end].decode("utf-8")
        mutant = Mutant(module, line + 1, lines[line], old, begin, end, new)
        keys[mutant.key] += 1
        every.append((replace(mutant, nth=keys[mutant.key]), constant))
    random.Random(module).shuffle(every)
    mutants: list[Mutant] = []
    constants = 0
    for mutant, constant in every:
        if len(mutants) == count:
            break
        if constant and CONSTANTS * (constants + 1) > len(mutants) + 1:
            continue
        constants += constant
        mutants.append(mutant)
    return mutants


# The trial


class Workshop:
    """A copy of the project in which faults are tried, one after the other."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        files = subprocess.run(
            ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"],
            cwd=ROOT, capture_output=True, check=True,
        ).stdout.decode()  # fmt: skip
        for name in filter(None, files.split("\0")):
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, folder / name)
        shared = ROOT.parent / "shared"
        if shared.exists() and not (folder.parent / "shared").exists():
            (folder.parent / "shared").symlink_to(shared)

    def test(self, module: str, within: float | None = None) -> tuple[bool, str, float]:
        """Return whether a module's tests pass, what failed, and how long they took [s]."""
        begun = time.monotonic()
        if module.startswith("c/"):
            source = str(self.folder / "firmware_protocol" / "c")
            command = ["make", "-s", "-C", source, f"BUILD={self.folder}/build-c", "check"]
            if self._run(command, within)[0]:
                return False, "make check", time.monotonic() - begun
        tests = [
            str(path.relative_to(self.folder))
            for name in TESTS[module].split()
            for path in [self.folder / "tests" / name]
            for path in [path if path.is_dir() else path.with_suffix(".py")]
        ]
        for marks in ("not ci and not realtime", "ci and not realtime"):
            pytest = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider"]
            code, out = self._run([*pytest, "-m", marks, *tests], within)
            if code not in (0, 5):  # 5: none has these marks
                failed = re.findall(r"^(?:FAILED|ERROR) (\S+)", out, re.MULTILINE)
                return False, (failed or [f"exit {code}"])[0], time.monotonic() - begun
        return True, "", time.monotonic() - begun

    def _run(self, command: list[str], within: float | None) -> tuple[int, str]:
        environment = os.environ | {"PYTHONPATH": str(self.folder), "OPENBLAS_NUM_THREADS": "1"}
        with subprocess.Popen(
            command, cwd=self.folder, env=environment, stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT, text=True, start_new_session=True,
        ) as process:  # fmt: skip
            try:
                out, _ = process.communicate(timeout=within)
            except subprocess.TimeoutExpired:
                os.killpg(process.pid, signal.SIGKILL)
                process.communicate()
                return 124, ""
            return process.returncode, out

    def try_out(self, mutant: Mutant, within: float) -> tuple[bool, str]:
        """Return whether the tests pass with a fault put in, and what failed."""
        path = self.folder / path_of(mutant.module)
        data = path.read_bytes()
        path.write_bytes(data[: mutant.begin] + mutant.text.encode() + data[mutant.end :])
        try:
            passed, why, _ = self.test(mutant.module, within)
        finally:
            path.write_bytes(data)
        return passed, why


@dataclass(frozen=True)
class TriedMutant:
    """A fault that was tried: whether a test noticed it, which, or why none could."""

    mutant: Mutant
    killed: bool
    by: str
    equivalent: str = ""


def tried(module: str, count: int, workshops: "Queue[Workshop]") -> Iterator[TriedMutant]:
    """Yield what becomes of each fault of a module."""
    reasons = tomllib.loads(EQUIVALENT.read_text("utf-8")).get(module, {})
    workshop = workshops.get()
    passed, why, seconds = workshop.test(module)
    workshops.put(workshop)
    if not passed:
        raise SystemExit(f"{module}: its tests fail without any fault: {why}")

    def one(mutant: Mutant) -> TriedMutant:
        if mutant.key in reasons:
            return TriedMutant(mutant, killed=False, by="", equivalent=reasons[mutant.key])
        workshop = workshops.get()
        try:
            passed, by = workshop.try_out(mutant, 3 * seconds + 25)
        finally:
            workshops.put(workshop)
        return TriedMutant(mutant, not passed, "" if passed else by)

    with ThreadPoolExecutor(workshops.maxsize) as pool:
        yield from pool.map(one, drawn(module, count))


def main() -> None:
    """Try modules and print what the tests missed."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("modules", nargs="*", metavar="MODULE", help=", ".join(TESTS))
    parser.add_argument("--count", type=int, default=COUNT, help="faults per module")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, help="tried at a time")
    parser.add_argument("--json", action="store_true", help="print each verdict as a line of JSON")
    words = parser.parse_args()
    unknown = set(words.modules) - set(TESTS)
    if unknown:
        parser.error(f"no tests are named for {', '.join(unknown)}; there are {', '.join(TESTS)}")
    with tempfile.TemporaryDirectory() as folder:
        workshops: Queue[Workshop] = Queue(words.jobs)
        for k in range(words.jobs):
            workshops.put(Workshop(Path(folder) / f"copy-{k}"))
        for module in words.modules or TESTS:
            verdicts = []
            for verdict in tried(module, words.count, workshops):
                verdicts.append(verdict)
                if words.json:
                    print(json.dumps(asdict(verdict)), flush=True)
                elif not verdict.killed and not verdict.equivalent:
                    one = verdict.mutant
                    print(f"{path_of(module)}:{one.line}: {one.key}", flush=True)
            if not words.json:
                counted = [v for v in verdicts if not v.equivalent]
                killed = sum(v.killed for v in counted)
                share = 100 * killed / len(counted) if counted else 100
                print(f"{module}: {killed} of {len(counted)} killed, {share:.0f} %, "
                      f"{len(verdicts) - len(counted)} equivalent", flush=True)  # fmt: skip


if __name__ == "__main__":
    main()
