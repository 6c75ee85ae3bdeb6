"""Who imports whom: what package.xml says, the floors of the house, and no circles. Read from the sources, lazy imports too."""

import ast
import sys
from collections.abc import Iterator, Mapping
from graphlib import CycleError, TopologicalSorter
from pathlib import Path
from xml.etree import ElementTree

import pytest

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = {path.parent.name: path.parent for path in sorted((ROOT / "ros2_ws/src").glob("*/package.xml"))}
ABOVE = {"np_training": ROOT / "training", "np_blind": ROOT / "benchmark"}

FLOORS = (
    {"np_description"},
    {"np_ros"},
    {"np_record"},
    {"np_effects"},
    {"np_control"},
    {"np_perception"},
    {"np_policy"},
    {"np_sim_bridge"},
    {"np_franka", "np_diagnosis"},
    {"np_bringup"},
    {"np_training", "np_blind"},
)
FLOOR = {name: level for level, names in enumerate(FLOORS) for name in names}
DOWN_THE_STAIRS = {("np_bringup", "np_training")}
"""The one arrow upwards: `make bench` measures the detector against its torch module where that is installed."""

KEYS = {
    "PIL": "python3-pil",
    "cv2": "python3-opencv",
    "jinja2": "python3-jinja2",
    "matplotlib": "python3-matplotlib",
    "mujoco_warp": "mujoco-warp",
    "numpy": "python3-numpy",
    "panda_py": "panda-python",
    "scipy": "python3-scipy",
    "warp": "warp-lang",
    "yaml": "python3-yaml",
}
"""What package.xml calls a module: rosdep's key, or the name of what only pip has. Others are called as they are."""


def modules() -> dict[str, Path]:
    """Every module of the project by its name."""
    found = {}
    for name, folder in {**PACKAGES, **ABOVE}.items():
        for path in (folder / name).rglob("*.py"):
            parts = path.relative_to(folder).with_suffix("").parts
            found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


MODULES = modules()


def tree(path: Path) -> ast.Module:
    return ast.parse(path.read_text(), path)


def imports(path: Path) -> Iterator[str]:
    """The modules that a file imports, in functions as well; `from a import b` is a.b where that is a module of ours."""
    for node in ast.walk(tree(path)):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: expected absolute imports"
            for alias in node.names:
                inside = f"{node.module}.{alias.name}"
                yield inside if inside in MODULES else node.module


def sources(package: str) -> list[Path]:
    return [*(PACKAGES[package] / package).rglob("*.py"), *PACKAGES[package].glob("launch/*.py")]


def imported(package: str) -> dict[str, str]:
    """By the name that package.xml has for it, one file that imports it."""
    found = {}
    for path in sources(package):
        for name in (module.partition(".")[0] for module in imports(path)):
            if name not in sys.stdlib_module_names and name != package and (package, name) not in DOWN_THE_STAIRS:
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
        for name in {other.partition(".")[0] for other in imports(path)} & FLOOR.keys() - {package}:
            if FLOOR[name] >= FLOOR[package] and FLOOR[package] < len(FLOORS) - 1:
                upwards.add((package, name))
    assert upwards == DOWN_THE_STAIRS


def test_nobody_imports_bringup():
    outside = {module: path for module, path in MODULES.items() if module.partition(".")[0] in PACKAGES}
    guilty = [
        module
        for module, path in outside.items()
        if not module.startswith("np_bringup") and any(name.split(".")[0] == "np_bringup" for name in imports(path))
    ]
    assert not guilty


def test_no_circle_between_packages():
    arrows = {name: set() for name in FLOOR}
    for module, path in MODULES.items():
        package = module.partition(".")[0]
        arrows[package] |= {name.partition(".")[0] for name in imports(path)} & FLOOR.keys() - {package}
    for package, above in DOWN_THE_STAIRS:
        arrows[package].discard(above)
    assert not circle(arrows)


def test_no_circle_between_modules():
    assert not circle({module: set(imports(path)) & MODULES.keys() for module, path in MODULES.items()})


def test_a_circle_is_seen():
    assert circle({"a": {"b"}, "b": {"c"}, "c": {"a"}, "d": {"a"}}) and not circle({"a": {"b"}, "b": {"c"}})
