"""`me3bev report` as a user meets it: a folder that stands alone, or a reason why there is none."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Callable
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import av
import pytest
from typer.testing import CliRunner, Result

from me3bev_cli.main import app
from me3bev_cli.reporting.clips import HOLD, WIDTH

Make = Callable[..., Path]


def run(*arguments: object) -> Result:
    return CliRunner().invoke(app, ["report", *map(str, arguments)])


def data(out: Path | str) -> dict[str, Any]:
    found: dict[str, Any] = json.loads((Path(out) / "report.json").read_text())
    return found


class Links(HTMLParser):
    """What a page refers to, and which ids it has."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.targets: list[str] = []
        self.ids: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        for name, value in attrs:
            if name in ("src", "href", "poster"):
                self.targets.append(value or "")
            elif name == "id":
                self.ids.append(value or "")


def test_a_report_stands_alone_and_has_the_evaluations_own_figures(evaluated: Make) -> None:
    one, other = evaluated("one"), evaluated("other", "seed=9", "policy.hidden=[4]")
    result = run(one, other, "--clips", 1)
    assert result.exit_code == 0, result.output
    assert "2 evaluations, 2 runs, 1 clips" in result.stdout
    page = Path("report/index.html").read_text()
    links = Links(page)
    assert {target.partition(":")[0] for target in links.targets if ":" in target} == {"data"}
    for target in links.targets:
        where, _, anchor = target.partition("#")
        assert not anchor or anchor in links.ids
        assert target.startswith("data:") or not where or (Path("report") / where).is_file(), target
    assert len(links.ids) == len(set(links.ids))
    assert not re.search(r"https?://(?!www\.w3\.org)", page)

    (suite,) = data("report")["suites"]
    assert [method["method"] for method in suite["methods"]] == ["one", "other", "random", "idle"]
    results = json.loads((one / "eval/F1,F2-low,high/results.json").read_text())
    assert [row for row in suite["rows"] if row["method"] == "one"] == [
        row for row in results["rows"] if row["method"] == "one"
    ]
    # Runs of two evaluations are compared on the same seeds.
    assert {(c["method"], c["baseline"]) for c in suite["comparisons"]} >= {("other", "one"), ("idle", "one")}
    assert {d["key"] for d in data("report")["recipes"]["differences"]} == {"seed", "policy.hidden"}
    assert "me3bev eval --run runs/other --checkpoint step_000000192 --reference random,idle --maps F1,F2" in page
    assert "me3bev train runs/one/recipe.yaml" in page


def test_a_clip_is_the_logged_drive(evaluated: Make) -> None:
    assert run(evaluated("one"), "--clips", 3).exit_code == 0
    shown = data("report")["failures"]
    assert {one["kind"] for one in shown} == {"timeout"}
    assert len(shown) == 3
    assert all(one["method"] == "one" and one["step"] == 12 for one in shown)
    with av.open(str(Path("report") / shown[0]["clip"])) as container:
        frames = list(container.decode(video=0))
        assert (container.streams.video[0].codec_context.name, frames[0].width) == ("vp9", WIDTH)
    assert len(frames) == 12 + HOLD
    assert len(list(Path("report/clips").glob("*.webp"))) == 3


def test_a_drive_that_is_not_the_logs_any_more_is_left_out(evaluated: Make, monkeypatch: pytest.MonkeyPatch) -> None:
    import fakes

    folder = evaluated("one")
    step = fakes.LineEnv.step

    def faster(self: Any, action: Any) -> Any:
        return step(self, [action[0], action[1] + 0.5])

    monkeypatch.setattr(fakes.LineEnv, "step", faster)
    result = run(folder, "--clips", 1)
    assert result.exit_code == 0, result.output
    assert "a clip is left out: the simulator has changed: from step 1 on" in result.stderr
    assert "No clip: the simulator has changed" in Path("report/index.html").read_text()
    monkeypatch.undo()


def test_a_town_that_is_not_installed(evaluated: Make, monkeypatch: pytest.MonkeyPatch) -> None:
    import fakes

    folder = evaluated("one")
    monkeypatch.setattr(fakes.LineSimulator, "maps", lambda self: ("F2",))
    result = run(folder, "--clips", 4)
    assert result.exit_code == 0, result.output
    assert "a clip is left out: the map 'F1' is not installed" in result.stderr
    clips = {bool(one["clip"]) for one in data("report")["failures"] if one["map"] == "F2"}
    assert clips == {True}


def test_an_earlier_report_is_replaced_and_nothing_else_is(evaluated: Make) -> None:
    folder = evaluated("one")
    assert run(folder, "--clips", 1).exit_code == 0
    Path("report/mine.txt").write_text("notes")
    assert run(folder, "--clips", 0, "--title", "Second <try>").exit_code == 0
    assert sorted(path.name for path in Path("report").iterdir()) == ["index.html", "mine.txt", "report.json"]
    assert "<h1>Second &lt;try&gt;</h1>" in Path("report/index.html").read_text()
    Path("other").mkdir()
    Path("other/thing").touch()
    for out in ("other", "line.yaml"):
        refused = run(folder, "--out", out)
        assert refused.exit_code == 2
        assert f"--out: {out} " in refused.stderr
    assert [path.name for path in Path("other").iterdir()] == ["thing"]


def test_what_cannot_be_reported(evaluated: Make) -> None:
    none = run()
    assert (none.exit_code, "`pretrained`" in none.stderr) == (2, True)
    assert "`me3bev eval --run pretrained --reference all` does it" in none.stderr
    folder = evaluated("one")
    assert "nowhere is neither a run nor an evaluation. The newest run is" in run("nowhere").stderr
    Path("empty").mkdir()
    assert "holds neither a run nor an evaluation" in run("empty").stderr
    assert "--clips: -1 is negative" in run(folder, "--clips", -1).stderr
    shutil.copytree(folder, "runs/new")
    shutil.rmtree("runs/new/eval")
    missing = run("new")
    assert "new has not been evaluated yet. `me3bev eval --run" in missing.stderr
    results = folder / "eval" / "F1,F2-low,high" / "results.json"
    whole = results.read_text()
    for text in ("{", "[]", '{"rows": []}', whole.replace('"mean"', '"main"')):
        results.write_text(text)
        damaged = run(folder)
        assert damaged.exit_code == 2, text
        assert "is no file of results, or a damaged one" in damaged.stderr
        assert "`me3bev eval --from-logs runs/one/eval/F1,F2-low,high` computes them again" in damaged.stderr
    results.unlink()
    assert "is not finished. The same command goes on" in run(folder).stderr
    results.write_text(whole)
    Path("odd.json").write_text("{}")
    assert "odd.json: is not what `me3bev bench-latency --json` writes" in run(folder, "--latency", "odd.json").stderr
    assert not Path("report").exists()


def test_parts_that_are_damaged_are_left_out_with_a_word(evaluated: Make) -> None:
    folder = evaluated("one")
    evaluated("two")
    logs = sorted((folder / "eval/F1,F2-low,high/episodes/one").glob("*.npz"))
    logs[0].write_bytes(logs[0].read_bytes()[:50])
    Path("runs/two/recipe.yaml").write_text("a: [")
    result = run("one", "two", "--clips", 0)
    assert result.exit_code == 0, result.output
    assert "the log is damaged or truncated" in result.stderr
    assert "the recipe of two is left out" in Path("report/index.html").read_text()


def test_an_evaluation_of_drivers_alone(evaluated: Make) -> None:
    evaluated("one")
    options = ["--maps", "F1", "--episodes", "12", "--workers", "0", "--out", "drivers"]
    command = ["eval", "--driver", "random", "--recipe", "line.yaml", *options, "--seed", "1"]
    assert CliRunner().invoke(app, command).exit_code == 0
    result = run("drivers", "--clips", 1, "--out", "page")
    assert result.exit_code == 0, result.output
    kinds = {one["kind"]: one for one in data("page")["failures"]}
    assert set(kinds) == {"vehicle", "timeout"}
    assert kinds["vehicle"]["at_fault"]
    assert "convergence" not in Links(Path("page/index.html").read_text()).ids
