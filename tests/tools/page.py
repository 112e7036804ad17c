"""A real browser looks at a real run, and at several: `cargo build && python3 tests/tools/page.py`.

Needs Chromium (Debian's package chromium). The curves must appear, in light and dark; when the learner is killed the page must
say so, and when it comes back on the same port the page must go on by itself, with the curves from the start of the run.
On the page of ten runs, of which one grows and one is damaged, the legend must hide and show runs by click and by keyboard, also after new
data, and the runs that differ only in their seed must become one curve with a band.
`--screenshots FOLDER` keeps pictures. Ends with 0 if all of it holds, and with 3 where no browser is installed.
"""

import argparse
import json
import pathlib
import subprocess
import tempfile

from browser import Tab, tab
from runs import PROGRAM, free_port, training

STATE = "document.getElementById('state').textContent"
CURVES = "document.querySelectorAll('figure path').length"
POINTS = "(document.querySelector('[id=\"chart training return\"] path')?.getAttribute('d').length ?? 0)"
TOP_SECTION = "[...document.querySelectorAll('#sections section')].find((section) => !section.hidden).id"
# Two looks at the film differ: the robot moves.
MOVES = "((now) => { const moved = window.seen !== undefined && window.seen !== now; window.seen = now; return moved; })" \
    "(document.querySelector('canvas').toDataURL())"
ITERATION = "Number(document.querySelector('#tiles b')?.textContent.replace(/,/g, '') ?? 0)"


def watch(page: Tab, folder: pathlib.Path, pictures: pathlib.Path | None) -> None:
    address = f"127.0.0.1:{free_port()}"
    with training(folder, address) as learner:
        page.show(f"http://{address}/")
        page.wait_until(f"{CURVES} > 10 && {POINTS} > 40 && {ITERATION} > 60")
        page.wait_until(f"{TOP_SECTION} === 'section Return'")
        for scheme in ("light", "dark"):
            page.look(scheme, 1200, 1500)
            page.wait_until(f"matchMedia('(prefers-color-scheme: {scheme})').matches")
            if pictures:
                page.screenshot(pictures / f"page-{scheme}.png")
        hover(page)
        page.wait_until(f"!document.getElementById('film').hidden && {MOVES}")
        learner.kill()
        page.wait_until(f"{STATE} === 'disconnected'")
        if pictures:
            page.screenshot(pictures / "page-disconnected.png")
    before, points = page.evaluate(ITERATION), page.evaluate(POINTS)
    with training(folder, address):
        page.wait_until(f"{STATE}.startsWith('running') && {ITERATION} > {before}")
        # Iterations after the last checkpoint are trained again; those before stand in the curve already.
        page.wait_until(f"{POINTS} >= {points // 2}")
    if page.complaints:
        raise SystemExit(f"the page complains: {page.complaints}")


RUNS = [f"{algorithm}-{seed}" for algorithm in ("happo", "mappo") for seed in range(1, 5)]
BUTTONS = "[...document.querySelectorAll('#runs button')]"
LEGEND = f"{BUTTONS}.map((button) => `${{button.textContent}}${{button.ariaPressed === 'true' ? '' : ' (hidden)'}}`).join()"
CHART = "document.querySelector('[id=\"chart evaluation return\"]')"
LINES, BANDS = f"{CHART}.querySelectorAll('path').length", f"{CHART}.querySelectorAll('polygon').length"


def several(page: Tab, place: pathlib.Path, pictures: pathlib.Path | None) -> None:
    """The page of ten runs; the eighth grows, the ninth has no figures, the tenth is damaged."""
    for name in RUNS:
        write_run(place / name, *name.split("-"))
    write_run(place / "new", "maddpg", "1")
    (place / "new" / "metrics.jsonl").unlink()
    write_run(place / "damaged", "happo", "9")
    (place / "damaged" / "config.toml").write_text("task = ")
    command = [PROGRAM, "page", *RUNS, "new", "damaged"]
    with subprocess.Popen(command, cwd=place, stdout=subprocess.PIPE, text=True) as process:
        try:
            page.show(process.stdout.readline().split()[-1])
            legend(page, place, pictures)
        finally:
            process.kill()
    if page.complaints:
        raise SystemExit(f"the page of several runs complains: {page.complaints}")


def legend(page: Tab, place: pathlib.Path, pictures: pathlib.Path | None) -> None:
    page.look("light", 1200, 900)
    page.wait_until(f"{LEGEND} === '{','.join([*RUNS, 'new', 'damaged'])}' && {LINES} === 9")
    page.wait_until(f"{STATE} === 'up to 19k environment steps'")
    notes = "document.getElementById('notes').textContent"
    page.wait_until(f"{notes}.includes('new: no figures yet') && {notes}.includes('config.toml')")
    if pictures:
        page.screenshot(pictures / "runs.png")
    page.evaluate(f"{BUTTONS}[0].click()")
    page.evaluate(f"{BUTTONS}[1].focus()")
    page.press(" ")
    hidden = f"{LEGEND}.startsWith('happo-1 (hidden),happo-2 (hidden),happo-3,')"
    page.wait_until(f"{hidden} && {LINES} === 7")
    # New data: the choice and the place of the keyboard stay.
    points = f"{CHART}.querySelectorAll('path')[5].getAttribute('d').length"
    before = page.evaluate(points)
    add_evaluations(place / RUNS[-1], range(20, 30), 4)
    page.wait_until(f"{points} > {before}")
    page.wait_until(f"{hidden} && {LINES} === 7 && document.activeElement === {BUTTONS}[1]")
    page.press(" ")
    page.wait_until(f"{LINES} === 8")
    page.evaluate("document.getElementById('group').click()")
    page.wait_until(f"{LEGEND} === 'happo (3 of 4 runs),mappo (4 runs),new,damaged' && {LINES} === 3 && {BANDS} === 2")
    # The mean at the last step: seeds 2 to 4 have the returns 38, 57 and 76.
    page.wait_until(f"{CHART}.querySelector('.values span').textContent === '57'")
    page.evaluate("(() => { const slider = document.getElementById('smoothing'); slider.value = 0.8; slider.oninput({target: slider}); })()")
    page.wait_until(f"{LINES} === 6 && {BANDS} === 2")
    if pictures:
        page.screenshot(pictures / "runs-grouped.png")
    page.evaluate(f"{BUTTONS}.forEach((button) => button.click())")
    page.wait_until(f"{CHART}.hidden")
    page.evaluate(f"{BUTTONS}[0].click()")
    page.wait_until(f"!{CHART}.hidden && {LEGEND}.startsWith('happo (4 runs),mappo (4 runs) (hidden)')")


def write_run(folder: pathlib.Path, algorithm: str, seed: str) -> None:
    folder.mkdir(parents=True)
    settings = ["halfcheetah-2x3", f"algorithm={algorithm}", f"run.seed={seed}"]
    resolved = subprocess.run([PROGRAM, "config", *settings], check=True, capture_output=True, text=True)
    (folder / "config.toml").write_text(resolved.stdout)
    add_evaluations(folder, range(20), int(seed))


def add_evaluations(folder: pathlib.Path, positions: range, seed: int) -> None:
    with (folder / "metrics.jsonl").open("a") as file:
        for k in positions:
            step = {"iteration": k, "env_steps": 1000 * k}
            file.write(json.dumps({"kind": "iteration", **step, "actors": 2, "agent0/loss": 1 / (1 + k + seed)}) + "\n")
            file.write(json.dumps({"kind": "evaluation", **step, "mean": seed * k}) + "\n")


def hover(page: Tab) -> None:
    """Values are told where the pointer is."""
    values = "document.querySelector('[id=\"chart training return\"] .values').textContent"
    newest = page.evaluate(values)
    box = "document.querySelector('[id=\"chart training return\"] svg').getBoundingClientRect()"
    x, y = page.evaluate(f"{box}.left + 80"), page.evaluate(f"{box}.top + 60")
    page.call("Input.dispatchMouseEvent", type="mouseMoved", x=x, y=y)
    page.wait_until(f"{values} !== {newest!r}")
    page.call("Input.dispatchMouseEvent", type="mouseMoved", x=1, y=1)


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--screenshots", type=pathlib.Path)
    pictures = parser.parse_args().screenshots
    if pictures:
        pictures.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as place, tab() as page:
        watch(page, pathlib.Path(place) / "run", pictures)
        several(page, pathlib.Path(place) / "several", pictures)
    print("a browser shows a run, says when its learner is gone, and goes on with the next one; and it shows several runs")


if __name__ == "__main__":
    main()
