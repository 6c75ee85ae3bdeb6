"""The documents: links lead somewhere, commands exist, generated pages say what data and code say."""

import ast
import re
from importlib.util import find_spec
from pathlib import Path

import pytest
from pages.markdown import fill

ROOT = Path(__file__).resolve().parents[2]
DOCUMENTS = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md")), *sorted((ROOT / "examples").glob("*.md"))]
TOLD = [
    ROOT / "README.md",
    *sorted((ROOT / "docs/guide").glob("*.md")),
    *sorted((ROOT / "docs/reference").glob("*.md")),
]
LONGEST = 160
STATEMENTS = ROOT / "docs/reference/graph.md"  # the contract: a statement is a line, so that a change to it is one too
CODE = re.compile(r"```.*?```|`[^`\n]+`", re.DOTALL)
LINK = re.compile(r"\]\(([^()\s]+)\)")


def name(path: Path) -> str:
    return str(path.relative_to(ROOT))


def text(path: Path) -> str:
    return path.read_text(encoding="utf-8")


def anchors(page: str) -> set[str]:
    """Anchors of a page's headings, as GitHub makes them."""
    headings = re.findall(r"^#+ (.+)$", re.sub(r"```.*?```", "", page, flags=re.DOTALL), re.MULTILINE)
    plain = [re.sub(r"[^\w\- ]", "", re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", heading)) for heading in headings]
    return {heading.strip().lower().replace(" ", "-") for heading in plain}


@pytest.mark.parametrize("document", DOCUMENTS, ids=name)
def test_links_lead_somewhere(document):
    broken = []
    for target in LINK.findall(CODE.sub("", text(document))):
        if re.match(r"[a-z]+:", target):
            continue
        path, _, anchor = target.partition("#")
        page = (document.parent / path) if path else document
        if not page.exists() or (anchor and anchor not in anchors(text(page))):
            broken.append(target)
    assert not broken


@pytest.mark.parametrize("document", [page for page in DOCUMENTS if page != STATEMENTS], ids=name)
def test_lines_can_be_read(document):
    prose = re.sub(r"```.*?```", "", text(document), flags=re.DOTALL).splitlines()
    assert not [line for line in prose if len(line) > LONGEST and not line.startswith("|") and "](" not in line]


def entry_points() -> set[tuple[str, str]]:
    """(package, executable) of the workspace, as its setup.py files say."""
    return {
        (setup.parent.name, node.value.split("=")[0].strip())
        for setup in (ROOT / "ros2_ws/src").glob("*/setup.py")
        for node in ast.walk(ast.parse(text(setup)))
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and ":main" in node.value
    }


@pytest.mark.parametrize("document", TOLD, ids=name)
def test_commands_exist(document):
    told = "\n".join(CODE.findall(text(document)))
    executables = set(re.findall(r"ros2 run (np_\w+) (\w+)", told))
    assert executables <= entry_points()
    packages = set(re.findall(r"ros2 pkg executables (\w+)", told))
    assert packages <= {package for package, _ in entry_points()}
    launches = set(re.findall(r"ros2 launch (\w+) ([\w.]+)", told))
    assert all((ROOT / "ros2_ws/src" / package / "launch" / file).exists() for package, file in launches)
    assert all(find_spec(module) for module in re.findall(r"python -m ((?:np_\w+|pytest)[\w.]*)", told))
    assert all((ROOT / script).exists() for script in re.findall(r"python ((?:tools|examples|tests)/\S+\.py)", told))
    targets = set(re.findall(r"^([a-z0-9-]+):", text(ROOT / "Makefile"), re.MULTILINE))
    assert set(re.findall(r"(?:^|`)make ([a-z][a-z0-9-]*)", told, re.MULTILINE)) <= targets


def test_the_readme_names_the_first_commands():
    told = "\n".join(CODE.findall(text(ROOT / "README.md")))
    assert "make demo" in told and "make test" in told


def test_generated_pages_say_what_data_and_code_say():
    from docs import generate

    written = generate(ROOT)
    differing = [page for page, wanted in written.items() if text(ROOT / page) != wanted]
    assert not differing, "run `make docs`"


@pytest.mark.parametrize("page", ["", "<!-- a --><!-- a --><!-- /a -->"])
def test_a_generated_part_must_have_its_markers_once(page):
    with pytest.raises(ValueError, match="expected <!-- a --> and <!-- /a --> once"):
        fill(page, a="new")
    assert fill("x <!-- a -->old<!-- /a --> y", a="new") == "x <!-- a -->new<!-- /a --> y"


def test_results_stay_few():
    """Superseded results belong to a tag."""
    files = list((ROOT / "docs/results").iterdir())
    assert len(files) <= 60 and sum(file.stat().st_size for file in files) <= 6_000_000
    linked = set(LINK.findall("".join(text(page) for page in files if page.suffix == ".md")))
    assert {file.name for file in files} - {"README.md"} <= linked
