"""The TypeScript client has the types of the API's messages, and what is built of it is current."""

import json
import random
import re
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from javascript_rig import CLIENT, MESSAGES, PROJECT, examples
from node_rig import tool

from clients import build, generate
from clients.model import ValueKind, api_model
from clients.typescript import _comment, _type
from tactile import messages

GENERATED = (CLIENT / "client" / "messages.ts").read_text("utf-8")
REQUIRED = {
    name: set(one["required"])
    for name, one in messages.schema()["$defs"].items()
    if "required" in one
}
"""Fields without a default of each message, by its class."""
Types = Callable[[str], list[str]]
"""Function from the text of a module to the errors of the compiler."""


def compiled(folder: Path, **options: Any) -> list[str]:
    """Compile modules with the configuration of the client, and return the errors."""
    configuration = {
        "extends": str(CLIENT / "tsconfig.json"),
        "compilerOptions": {"noEmit": True, "rootDir": "/", "noUnusedLocals": False, **options},
        "include": [str(folder)],
    }
    (folder / "tsconfig.json").write_text(json.dumps(configuration))
    command = [tool("tsc"), "--project", str(folder), "--pretty", "false"]
    run = subprocess.run(command, capture_output=True, text=True, check=False)
    lines = (run.stdout + run.stderr).splitlines()
    return [line for line in lines if line and not line.startswith(" ")]


@pytest.fixture
def types(tmp_path: Path) -> Types:
    """Compile a module that has all types of the client."""

    def errors(text: str) -> list[str]:
        names = ", ".join(re.findall(r"export (?:type|interface) (\w+)", GENERATED))
        home = json.dumps(str(CLIENT / "client" / "messages.js"))
        (tmp_path / "cases.ts").write_text(f"import type {{ {names} }} from {home};\n{text}")
        return compiled(tmp_path)

    return errors


def literal(value: Any) -> str:
    """Return a plain value as an expression."""
    match value:
        case bytes():
            return f"new Uint8Array({json.dumps(list(value))})"
        case dict():
            return f"{{{', '.join(f'{json.dumps(k)}: {literal(v)}' for k, v in value.items())}}}"
        case list():
            return f"[{', '.join(map(literal, value))}]"
    return json.dumps(value)


# The generated module


def test_generated_files_are_current(capsys: pytest.CaptureFixture[str]) -> None:
    assert generate.main(["--check"]) == 0, capsys.readouterr().err


def test_a_file_that_differs_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(generate, "HERE", tmp_path)
    for name in generate.TEMPLATES:
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
    assert generate.main(["--check"]) == 1
    lines = capsys.readouterr().err.splitlines()
    assert lines[0] == "messages.ts differs; run python -m clients.generate"
    assert len(lines) == len(generate.TEMPLATES)
    assert generate.main([]) == 0
    assert generate.main(["--check"]) == 0


def test_constants_are_those_of_the_api() -> None:
    constants = dict(re.findall(r"export const (\w+) = (.*);", GENERATED))
    assert len(constants) == 8
    assert {name: json.loads(text) for name, text in constants.items()} == {
        name: getattr(messages, name) for name in constants
    }


def test_every_message_and_field_is_described() -> None:
    model = api_model()
    assert {one.tag for one in model.structures} - {""} == {
        one.__struct_config__.tag for one in MESSAGES
    }
    assert all(field.doc for one in model.structures for field in one.fields)
    assert all(one.doc for one in model.structures)
    assert all(one.doc for one in (*model.enumerations, *model.sums))
    by_name = {one.name: one for one in model.structures}
    force = {field.name: field for field in by_name["Contact"].fields}["normal_force_n"]
    assert force.doc == "Normal force [N]; 0 lifts the finger."
    assert by_name["GetStats"].doc == "Ask for the state of a display; answered by `StatsReply`."


@pytest.mark.parametrize(
    ("kind", "text"),
    [
        (
            ValueKind("list", (ValueKind("any_of", (ValueKind("number"), ValueKind("null"))),)),
            "(number | null)[]",
        ),
        (
            ValueKind("map", (ValueKind("list", (ValueKind("bytes"),)),)),
            "Record<string, Uint8Array[]>",
        ),
        (
            ValueKind("tuple", (ValueKind("integer"), ValueKind("named", name="Code"))),
            "[number, Code]",
        ),
        (ValueKind("list", (ValueKind("values", values=("up", "down")),)), '("up" | "down")[]'),
    ],
)
def test_compositions_of_kinds_are_types(kind: ValueKind, text: str) -> None:
    assert _type(kind) == text


def test_no_description_ends_its_comment() -> None:
    assert _comment("Any of a */ b, as ``c``.") == "/** Any of a *\\/ b, as `c`. */\n"


# Types, against messages that are made from the Python types


@pytest.mark.ci
def test_every_message_of_the_api_has_the_type(types: Types) -> None:
    rng = random.Random("types")
    cases = [
        f"const m{i}: {name} = {literal(value)};\n"
        for i, (name, value) in enumerate(examples(rng, 8))
    ]
    assert len(cases) == 8 * len(MESSAGES)
    assert types("".join(cases)) == []


@pytest.mark.ci
def test_no_other_message_has_the_type(types: Types) -> None:
    """Missing and unknown fields, wrong tags and wrong values are errors, in each field of each."""
    wrong: list[str] = []
    for name, value in examples(random.Random("wrong"), 2):
        whole = {key: literal(field) for key, field in value.items()}
        cases = [whole | {"type": '"nothing"'}, whole | {"unknown": "0"}]
        cases += [whole | {key: "Symbol()"} for key in whole]
        minimal = {key: whole[key] for key in whole if key in REQUIRED[name]}
        cases += [{k: v for k, v in minimal.items() if k != key} for key in minimal]
        for case in cases:
            fields = ", ".join(f"{json.dumps(key)}: {text}" for key, text in case.items())
            wrong.append(f"const w{len(wrong)}: {name} = {{ {fields} }};\n")
    assert types("".join(f"// @ts-expect-error\n{line}" for line in wrong)) == []


@pytest.mark.ci
def test_commands_and_answers_are_told_apart_by_their_tag(types: Types) -> None:
    text = """
const a: Command = { type: "contact", display: "right", position_mm: [0, 1], normal_force_n: 1 };
const b: Command = { type: "append", display: "right", sample_rate_hz: 8000, amplitude_um: 1,
  samples: new Uint8Array(4) };
const c: Command = { type: "effect", display: "right", amplitude_um: 1,
  transients: [[0, 1], [5, 1, 200]] };
function hello(answer: Answer): string[] {
  if (answer.type === "failure") { const code: Code = answer.code; return [code]; }
  return answer.type === "welcome" ? answer.displays.map((d) => d.name) : [];
}
// @ts-expect-error: force is missing
const d: Command = { type: "contact", display: "right", position_mm: [0, 1] };
// @ts-expect-error: a position has two coordinates
const e: Command = { type: "contact", display: "right", position_mm: [0, 1, 2], normal_force_n: 1 };
// @ts-expect-error: there is no such field
const f: Command = { type: "gain", display: "right", gian: 1 };
// @ts-expect-error: an answer is no command
const g: Command = { type: "pong", time_us: 1, server_time_us: 1 };
// @ts-expect-error: there is no such code
const h: Failure = { type: "failure", code: "lost", message: "" };
// @ts-expect-error: a transient has a value
const i: Transient = [0];
"""
    assert types(text) == []


@pytest.mark.ci
def test_examples_have_no_errors_of_types(tmp_path: Path) -> None:
    """Check the README's example, the quick start, and that a mistake in one is noticed."""
    (tmp_path / "globals.d.ts").write_text(
        "declare const pad: HTMLElement, stopButton: HTMLElement, process: { argv: string[] };\n"
        'declare module "ws" { const webSocket: typeof WebSocket; export default webSocket; }\n'
    )
    readme = (CLIENT / "README.md").read_text("utf-8")
    (example,) = re.findall(r"```js\n(.*?)```", readme, re.DOTALL)
    (tmp_path / "readme.mjs").write_text(example)
    (tmp_path / "mistake.mjs").write_text(example.replace("display.lift", "display.lfit"))
    shutil.copy(CLIENT / "examples" / "quickstart.mjs", tmp_path)
    home = {"tactile-client": [str(CLIENT / "client" / "index.ts")]}
    (mistake,) = compiled(tmp_path, module="ES2022", allowJs=True, checkJs=True, paths=home)
    assert "mistake.mjs" in mistake
    assert "'lfit' does not exist on type 'Display'" in mistake


# What is built


@pytest.mark.ci
def test_what_the_server_serves_is_current(capsys: pytest.CaptureFixture[str]) -> None:
    tool("tsc")
    assert build.main(["--check"]) == 0, capsys.readouterr().err


def test_the_build_writes_what_differs_and_removes_what_is_too_much(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    built = {"client/index.js": "1;\n", "page/main.js": "2;\n", "page/part/of/a.js": "3;\n"}
    monkeypatch.setattr(build, "compiled", lambda: built)
    monkeypatch.setattr(build, "WEB", tmp_path)
    for name, text in {"index.html": "", "page/main.js": "old", "page/old.js": ""}.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(text)
    names = ["client/index.js", "page/main.js", "page/old.js", "page/part/of/a.js"]
    assert build.main(["--check"]) == 1
    lines = capsys.readouterr().err.splitlines()
    assert lines == [f"web/{name} differs; run python -m clients.build" for name in names]
    assert build.scripts_in(tmp_path) == {"page/main.js": "old", "page/old.js": ""}
    assert build.main([]) == 0
    assert build.main(["--check"]) == 0
    assert build.scripts_in(tmp_path) == built
    assert (tmp_path / "index.html").exists()


def test_without_a_compiler_one_line_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", "")
    with pytest.raises(SystemExit, match=r"^no tsc on PATH: install TypeScript, .*$"):
        build.main([])


@pytest.mark.parametrize(
    ("ci", "outcome"), [("true", pytest.fail.Exception), ("", pytest.skip.Exception)]
)
def test_a_missing_tool_fails_in_ci_only(
    monkeypatch: pytest.MonkeyPatch, ci: str, outcome: type[BaseException]
) -> None:
    monkeypatch.setenv("CI", ci)
    with pytest.raises(outcome, match="no no-such-tool on PATH"):
        tool("no-such-tool")


def test_the_package_has_the_version_of_the_project() -> None:
    package = json.loads((CLIENT / "package.json").read_text("utf-8"))
    version = re.search(r'^version = "(.*)"$', (PROJECT / "pyproject.toml").read_text(), re.M)
    assert version is not None
    assert package["version"] == version[1]
    assert not {"dependencies", "devDependencies"} & set(package)
