"""Who imports whom: what package.xml says, the floors of the house, and no circles. Read from the sources, lazy imports too."""

import ast
import subprocess
import sys
from collections.abc import Mapping
from graphlib import CycleError, TopologicalSorter
from xml.etree import ElementTree

import pytest
from packages import (
    ABOVE,
    FLOOR,
    FLOORS,
    PACKAGES,
    ROOT,
    imports,
    modules,
    own_tests,
    packages_of,
    sources,
    tree,
)

MODULES = modules()

KEYS = {
    "PIL": "python3-pil",
    "cv2": "python3-opencv",
    "jinja2": "python3-jinja2",
    "jsonschema": "python3-jsonschema",
    "matplotlib": "python3-matplotlib",
    "mujoco_warp": "mujoco-warp",
    "numpy": "python3-numpy",
    "panda_py": "panda-python",
    "scipy": "python3-scipy",
    "tqdm": "python3-tqdm",
    "warp": "warp-lang",
    "yaml": "python3-yaml",
}
"""What package.xml calls a module: rosdep's key, or the name of what only pip has. Others are called as they are."""


def imported(package: str) -> dict[str, str]:
    """By the name that package.xml has for it, one file that imports it."""
    found = {}
    for path in sources(package):
        for name in (module.partition(".")[0] for module in imports(path)):
            if name not in sys.stdlib_module_names and name != package:
                found[KEYS.get(name, name)] = str(path.relative_to(ROOT))
    return found


def launched(package: str) -> set[str]:
    """The packages whose nodes it starts."""
    calls = [node for path in sources(package) for node in ast.walk(tree(path)) if isinstance(node, ast.Call)]
    specs = [call for call in calls if isinstance(call.func, ast.Name) and call.func.id == "NodeSpec"]
    return {spec.args[0].value for spec in specs if spec.args and isinstance(spec.args[0], ast.Constant)}


def circle(arrows: Mapping[str, set[str]]) -> str:
    """A circle in words, "" for none."""
    try:
        TopologicalSorter(arrows).prepare()
    except CycleError as error:
        return " <- ".join(error.args[1])
    return ""


@pytest.mark.parametrize("package", PACKAGES)
def test_package_xml_lists_what_is_imported_and_nothing_else(package):
    manifest = ElementTree.parse(PACKAGES[package] / "package.xml")
    declared = [e.text for tag in ("depend", "exec_depend") for e in manifest.iter(tag)]
    used = imported(package)
    missing = [f"{package} imports {name} ({used[name]})" for name in sorted(used.keys() - set(declared))]
    idle = sorted(set(declared) - used.keys() - launched(package))
    assert not missing, f"not in package.xml: {'; '.join(missing)}"
    assert not idle, f"{package}/package.xml lists what nothing there imports: {', '.join(idle)}"
    assert len(declared) == len(set(declared)), f"{package}/package.xml lists something twice: {declared}"


def test_packages_import_only_from_lower_floors():
    assert FLOOR.keys() == PACKAGES.keys() | ABOVE.keys()
    upwards = set()
    for module, path in MODULES.items():
        package = module.partition(".")[0]
        for name in packages_of(path) - {package}:
            if FLOOR[name] >= FLOOR[package] and FLOOR[package] < len(FLOORS) - 1:
                upwards.add((package, name))
    assert not upwards


def test_only_the_evaluation_and_the_benchmark_import_bringup():
    assert not [
        m
        for m, path in MODULES.items()
        if not m.startswith(("np_bringup", "np_evaluation", "np_blind.robots.")) and "np_bringup" in packages_of(path)
    ]


def test_what_is_imported_is_there():
    """Where a module was moved, nothing names the old one: not in a function, a test, a tool or an example either."""
    scripts = [path for folder in ("tests", "tools", "examples") for path in (ROOT / folder).rglob("*.py")]
    missing = {
        f"{path.relative_to(ROOT)}: {name}"
        for path in [*MODULES.values(), *scripts]
        for name in imports(path)
        if name.partition(".")[0] in FLOOR and name not in MODULES
    }
    assert not missing


def test_no_circle_between_packages():
    arrows = {name: set() for name in FLOOR}
    for module, path in MODULES.items():
        package = module.partition(".")[0]
        arrows[package] |= packages_of(path) - {package}
    assert not circle(arrows)


def test_no_circle_between_modules():
    assert not circle({module: set(imports(path)) & MODULES.keys() for module, path in MODULES.items()})


def test_a_circle_is_seen():
    assert circle({"a": {"b"}, "b": {"c"}, "c": {"a"}, "d": {"a"}}) and not circle({"a": {"b"}, "b": {"c"}})


def test_tests_lie_in_the_folder_of_the_highest_package_that_they_import():
    misplaced = {
        f"{path.relative_to(ROOT)}: belongs to {highest}"
        for package in FLOOR
        for path in own_tests(package)
        if (highest := max(packages_of(path), key=FLOOR.get, default=package)) != package
    }
    assert not misplaced


@pytest.mark.slow
def test_pytest_in_the_folder_of_a_package_finds_its_tests():
    """As `colcon test` calls it."""
    command = [sys.executable, "-m", "pytest", "--collect-only", "-q", "-p", "no:cacheprovider"]
    said = subprocess.run(command, cwd=PACKAGES["np_description"], capture_output=True, text=True)
    assert said.returncode == 0, said.stdout + said.stderr
    files = {line.partition("::")[0] for line in said.stdout.splitlines() if "::" in line}
    assert files == {str(path.relative_to(ROOT)) for path in own_tests("np_description")}
