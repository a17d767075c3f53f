"""What is installed is what is in the folders, and importing the command line stays cheap."""

from __future__ import annotations

import ast
import importlib.metadata
import os
import re
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from fnmatch import fnmatch
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
PACKAGE_DIR: dict[str, str] = PROJECT["tool"]["setuptools"]["package-dir"]
PACKAGES: list[str] = PROJECT["tool"]["setuptools"]["packages"]
GROUPS: dict[str, dict[str, str]] = PROJECT["project"]["entry-points"]
SKIPPED = {".git", ".venv", "__pycache__", "build", "dist", "runs", "node_modules"}


def folder_of(package: str) -> Path:
    top, *rest = package.split(".")
    return ROOT.joinpath(PACKAGE_DIR[top], *rest)


def module_of(path: Path) -> str:
    """The import name of a source file below a mapped folder."""
    for package, folder in PACKAGE_DIR.items():
        if path.is_relative_to(ROOT / folder):
            parts = path.relative_to(ROOT / folder).with_suffix("").parts
            return ".".join((package, *(part for part in parts if part != "__init__")))
    raise AssertionError(path)


def sources(folder: str) -> list[Path]:
    return sorted(path for path in (ROOT / folder).rglob("*.py") if not SKIPPED & set(path.parts))


def project_files() -> Iterator[Path]:
    for folder, folders, names in os.walk(ROOT):
        folders[:] = [name for name in folders if name not in SKIPPED and not name.endswith((".egg-info", "_cache"))]
        yield from (Path(folder, name) for name in names)


def test_every_folder_of_sources_is_packaged() -> None:
    found = {module_of(path.parent / "__init__.py") for folder in PACKAGE_DIR.values() for path in sources(folder)}
    assert found == set(PACKAGES)
    assert len(PACKAGES) == len(set(PACKAGES))


def test_every_package_has_an_init_file() -> None:
    assert [package for package in PACKAGES if not (folder_of(package) / "__init__.py").is_file()] == []


RESULTS = ROOT / "recipes" / "results"
"""Figures and pictures that the README shows: kept with the sources, not shipped."""


def test_every_data_file_is_packaged() -> None:
    data = PROJECT["tool"]["setuptools"]["package-data"]
    left_out = []
    for path in project_files():
        owner = next((p for p, folder in PACKAGE_DIR.items() if path.is_relative_to(ROOT / folder)), None)
        if owner is None or path.suffix == ".py" or path.is_relative_to(RESULTS):
            continue
        inside = {p: path.relative_to(folder_of(p)).as_posix() for p in data if path.is_relative_to(folder_of(p))}
        if not any(fnmatch(name, pattern) for p, name in inside.items() for pattern in data[p]):
            left_out.append(str(path))
    assert left_out == []


def test_every_plugin_module_is_registered() -> None:
    """A class with a Config and a forward is a plugin; it is registered under its module's name."""
    for kind in ("spatial", "temporal", "fusion"):
        found = {}
        for path in sources(f"plugins/{kind}"):
            for node in ast.parse(path.read_text()).body:
                if isinstance(node, ast.ClassDef) and {"Config", "forward"} <= set(_members(node)):
                    found[path.stem] = f"{module_of(path)}:{node.name}"
        assert found == GROUPS[f"me3bev.{kind}"]


def _members(node: ast.ClassDef) -> Iterator[str]:
    for child in node.body:
        if isinstance(child, ast.ClassDef | ast.FunctionDef):
            yield child.name
        elif isinstance(child, ast.Assign):
            yield from (target.id for target in child.targets if isinstance(target, ast.Name))
        elif isinstance(child, ast.AnnAssign) and isinstance(child.target, ast.Name):
            yield child.target.id


def test_what_is_installed_is_what_pyproject_says() -> None:
    """A new entry point or script needs a new `pip install -e .`."""
    distribution = importlib.metadata.distribution("me3bev")
    for group, expected in GROUPS.items():
        installed = {p.name: p.value for p in distribution.entry_points if p.group == group}
        assert installed == expected, "run pip install -e . again"
    scripts = {p.name: p.value for p in distribution.entry_points if p.group == "console_scripts"}
    assert scripts == PROJECT["project"]["scripts"]
    version = re.search(r'__version__ = "(.+)"', (ROOT / "me3bev_cli/__init__.py").read_text())
    assert version is not None
    assert distribution.version == version[1]


def test_nothing_imports_a_mapped_folder_by_its_folder_name() -> None:
    """From the repository's root `import plugins` would make a second copy of every class."""
    wrong = []
    for path in [*(p for folder in PACKAGE_DIR.values() for p in sources(folder)), *sources("tests")]:
        for node in ast.walk(ast.parse(path.read_text())):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            if isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
                names = [node.module]
            if {name.split(".")[0] for name in names} & {"plugins", "recipes"}:
                wrong.append(f"{path}:{node.lineno}")  # type: ignore[attr-defined]
    assert wrong == []


def imports(path: Path) -> Iterator[str]:
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            package = module_of(path.parent / "__init__.py").split(".")
            base = package[: len(package) - node.level + 1] if node.level else []
            stem = ".".join([*base, *([node.module] if node.module else [])])
            yield from (f"{stem}.{alias.name}" for alias in node.names)


def test_the_core_imports_no_plugin() -> None:
    wrong = [str(p) for p in sources("me3bev_cli") if any(name.startswith("me3bev_plugins") for name in imports(p))]
    assert wrong == []


def test_no_plugin_imports_another_or_more_of_the_core_than_its_contract() -> None:
    allowed = ("me3bev_cli.api", "me3bev_cli.errors", "me3bev_cli.files", "me3bev_cli.seeding")
    entry_modules = {value.partition(":")[0] for group in GROUPS.values() for value in group.values()}
    wrong = []
    for path in sources("plugins"):
        module = module_of(path)
        for name in imports(path):
            foreign = [e for e in entry_modules if (name + ".").startswith(e + ".") and not module.startswith(e)]
            if foreign or (name.startswith("me3bev_cli") and not name.startswith(allowed)):
                wrong.append(f"{module} imports {name}")
    assert wrong == []


def run_python(code: str) -> str:
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT, timeout=120)
    assert done.returncode == 0, done.stderr
    return done.stdout


HEAVY = "[name for name in ('torch', 'numpy', 'pydantic', 'rich', 'gymnasium') if name in sys.modules]"


@pytest.mark.parametrize("module", ["me3bev_cli", "me3bev_cli.main"])
def test_the_command_line_imports_nothing_heavy(module: str) -> None:
    assert run_python(f"import sys, {module}; print({HEAVY})").strip() == "[]"


@pytest.mark.parametrize("module", ["api", "registry", "recipe", "recipe_loading", "recipe_check", "recipe_schema"])
def test_recipes_and_the_registry_import_neither_torch_nor_numpy(module: str) -> None:
    code = f"import sys, me3bev_cli.{module}; print([m for m in ('torch', 'numpy') if m in sys.modules])"
    assert run_python(code).strip() == "[]"


def test_help_fits_a_screen_and_imports_nothing_heavy() -> None:
    run = "try: main()\nexcept SystemExit: pass"
    code = f"import sys; sys.argv = ['me3bev', '--help']\nfrom me3bev_cli.main import main\n{run}\nprint({HEAVY})"
    *lines, heavy = run_python(code).rstrip().splitlines()
    assert heavy == "[]"
    assert len(lines) <= 30
    assert max(map(len, lines)) <= 100
    verbs = [line.split()[0] for line in lines[lines.index("Commands:") + 1 : lines.index("Helpers:") - 1]]
    benches = ["bench-latency", "bench-env", "bench-train"]
    assert verbs == ["collect", "train", "eval", "runs", "plot", "report", "drive", "decode", *benches]


def test_make_targets_that_the_readme_names_exist() -> None:
    targets = set(re.findall(r"^([\w-]+):", (ROOT / "Makefile").read_text(), re.MULTILINE))
    named = set(re.findall(r"\bmake ([a-z][\w-]*)\b(?=`|\s*(?:#|$))", (ROOT / "README.md").read_text(), re.MULTILINE))
    assert named <= targets
    assert {"demo", "test", "check", "clean"} <= targets


def test_constraints_pin_dependencies_by_name_and_leave_torch_to_the_platform() -> None:
    lines = (ROOT / "constraints.txt").read_text().splitlines()
    pins = [line for line in lines if line and not line.startswith("#")]
    assert [pin for pin in pins if not re.fullmatch(r"[\w.-]+==[\w.]+", pin)] == []
    pinned = {pin.partition("==")[0].lower() for pin in pins}
    project = PROJECT["project"]
    needed = [*project["dependencies"], *project["optional-dependencies"]["test"]]
    direct = {re.match(r"[\w.-]+", line)[0].lower() for line in needed}  # type: ignore[index]
    assert pinned == direct - {"torch", "torchvision"}


def test_no_file_names_a_package_registry() -> None:
    hosts = [f"{name}.{domain}" for name, domain in (("pypi", "org"), ("pythonhosted", "org"), ("pytorch", "org/whl"))]
    hosts += ["index" + "-url", "anaconda" + ".org", "npmjs" + ".org"]
    wrong = []
    for path in project_files():
        if path.suffix in (".gz", ".png", ".webp", ".mcap", ".safetensors"):
            continue
        text = path.read_text(errors="ignore")
        wrong += [f"{path}: {host}" for host in hosts if host in text]
    assert wrong == []
