"""A real browser looks at a real run, at the finished run, and at several: `cargo build && python3 tests/tools/page.py`.

Needs Chromium (Debian's package chromium). The return and the robot must appear, in light and dark; when the learner is killed the
page must say so, and when it comes back on the same port the page must continue by itself, with the curves from the start of the run.
On the page of the run's folder the view must be in the address and come back from it, and episodes can be chosen.
On the page of ten runs, of which one grows and one is damaged, the legend must hide and show runs by click and by keyboard, also after new
data, the runs that differ only in their seed must become one curve with a band, and metrics that never change must have no chart.
`--screenshots FOLDER` keeps pictures. Ends with 0 if all of it holds, and with 3 where no browser is installed.
"""

import argparse
import contextlib
import json
import pathlib
import subprocess
import tempfile
from collections.abc import Iterator

from browser import Tab, tab
from runs import PROGRAM, free_port, training

STATE = "document.getElementById('state').textContent"
POINTS = "(document.querySelector('[id=\"chart training return\"] path')?.getAttribute('d').length ?? 0)"
FIGURES = "[...document.querySelectorAll('figure')].filter((figure) => figure.checkVisibility()).map((figure) => figure.id).join()"
PICTURE = "document.querySelector('canvas').toDataURL()"
# Two looks at the robot differ: it moves.
MOVES = f"((now) => {{ const moved = window.pictured !== undefined && window.pictured !== now; window.pictured = now; return moved; }})({PICTURE})"
EPISODE = "document.getElementById('filmed').textContent"
ITERATION = "Number(document.querySelector('#tiles b')?.textContent.replace(/,/g, '') ?? 0)"
SIZES = {"wide": (1280, 1000), "narrow": (390, 844)}


def watch(page: Tab, folder: pathlib.Path, pictures: pathlib.Path | None) -> None:
    address = f"127.0.0.1:{free_port()}"
    with training(folder, address) as learner:
        page.show(f"http://{address}/")
        page.wait_until(f"{POINTS} > 40 && {ITERATION} > 60 && {EPISODE}.startsWith('iteration ')")
        page.wait_until(f"{FIGURES} === 'chart evaluation return,chart training return'")
        page.wait_until("!document.getElementById('work').open")
        page.wait_until(MOVES)
        photograph(page, "live", pictures)
        page.look("light", *SIZES["wide"])
        hover(page)
        learner.kill()
        page.wait_until(f"{STATE} === 'disconnected'")
    before, points = page.evaluate(ITERATION), page.evaluate(POINTS)
    with training(folder, address):
        page.wait_until(f"{STATE}.startsWith('running') && {ITERATION} > {before}")
        # Iterations after the last checkpoint are trained again; those before are in the curve already.
        page.wait_until(f"{POINTS} >= {points // 2}")
    demand_no_complaints(page, "a live run")


def photograph(page: Tab, name: str, pictures: pathlib.Path | None) -> None:
    """Shows the page in both sizes, light and dark; nothing may be wider than the window."""
    for size, (width, height) in SIZES.items():
        for scheme in ("light", "dark"):
            page.look(scheme, width, height)
            page.wait_until(f"matchMedia('(prefers-color-scheme: {scheme})').matches && innerWidth === {width}")
            page.wait_until("document.documentElement.scrollWidth <= innerWidth")
            if pictures:
                page.screenshot(pictures / f"{name}-{size}-{scheme}.png")


def demand_no_complaints(page: Tab, what: str) -> None:
    if page.complaints:
        raise SystemExit(f"the page of {what} complains: {page.complaints}")


@contextlib.contextmanager
def page_of(folder: pathlib.Path, *names: str) -> Iterator[str]:
    """The address of `s2mia page` for these runs in a folder."""
    with subprocess.Popen([PROGRAM, "page", *names], cwd=folder, stdout=subprocess.PIPE, text=True) as process:
        try:
            yield process.stdout.readline().split()[-1]
        finally:
            process.kill()


def finished(page: Tab, folder: pathlib.Path, pictures: pathlib.Path | None) -> None:
    """The page of one folder: its episodes and settings, and the view in the address."""
    with page_of(folder.parent, folder.name) as url:
        page.show(url)
        page.wait_until(f"document.getElementById('name').textContent === '{folder.name}' && {MOVES}")
        page.wait_until("document.getElementById('live').hidden")
        choose = "((input) => {{ input.value = {value}; input.dispatchEvent(new Event('{event}')); }})(document.getElementById('{name}'))"
        page.evaluate(choose.format(name="episode", value=1, event="change"))
        page.wait_until(f"{EPISODE}.includes(', episode 1: return ')")
        page.evaluate(choose.format(name="time", value=3, event="input"))
        page.evaluate("[...document.querySelectorAll('[data-camera]')].at(-1).click()")
        page.wait_until("['time=3.00', 'episode=1', 'camera='].every((part) => location.hash.includes(part))")
        photograph(page, "finished", pictures)
        page.look("light", *SIZES["wide"])
        page.wait_until(f"!({MOVES})")
        paused, address = page.evaluate(PICTURE), page.evaluate("location.href")
        page.show(address)
        page.look("light", *SIZES["wide"])
        page.wait_until(f"{EPISODE}.includes(', episode 1: return ') && document.getElementById('play').textContent === 'play'")
        page.wait_until(f"{PICTURE} === {json.dumps(paused)}")
        page.show(f"{url}/#episode=99999999999")
        page.wait_until(f"{EPISODE}.includes(', episode 999: return ')")
        metrics_and_settings(page, url, folder)
    demand_no_complaints(page, "a finished run")


def metrics_and_settings(page: Tab, url: str, folder: pathlib.Path) -> None:
    page.show(f"{url}/#tab=metrics&filter=exact+kl")
    page.wait_until(f"{FIGURES} === 'chart exact_kl' && document.getElementById('overview').hidden")
    meaning = "document.querySelector('figure summary').title"
    page.wait_until(f"{meaning}.includes('closed form, after the update')")
    # The tables of docs/PAPER.md explain every metric.
    page.wait_until("drawn.size > 40 && [...drawn.values()].every((chart) => meanings.has(chart.metric))")
    # The arrow key moves to the next tab, and the address follows.
    key = "new KeyboardEvent('keydown', {key: 'ArrowRight', bubbles: true})"
    page.evaluate(f"document.getElementById('tab-metrics').dispatchEvent({key})")
    page.wait_until("location.hash.includes('tab=settings') && document.activeElement.id === 'tab-settings'")
    settings = json.dumps((folder / "config.toml").read_text())
    page.wait_until(f"document.getElementById('toml').textContent === {settings}")
    page.wait_until("document.getElementById('command').textContent.startsWith('s2mia train halfcheetah-2x3 ')")


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
    with page_of(place, *RUNS, "new", "damaged") as url:
        page.show(url)
        legend(page, place, pictures)
        page.evaluate("document.getElementById('tab-metrics').click()")
        page.wait_until(f"{FIGURES} === 'chart loss'")
        page.show(f"{url}/#tab=metrics&filter=actors")
        page.wait_until(f"document.querySelector('[id=\"group Time and health\"] .constants')?.textContent === 'constant: actors 2'")
        page.wait_until(f"{FIGURES} === ''")
        page.show(f"{url}/#tab=metrics&filter=reward")
        page.wait_until("document.querySelector('[id=\"group Reward terms\"] .constants')?.textContent === 'constant: reward/alive 1'")
    demand_no_complaints(page, "several runs")


def legend(page: Tab, place: pathlib.Path, pictures: pathlib.Path | None) -> None:
    page.look("light", 1200, 900)
    page.wait_until(f"{LEGEND} === '{','.join([*RUNS, 'new', 'damaged'])}' && {LINES} === 9")
    page.wait_until(f"{STATE} === 'up to 19k environment steps'")
    notes = "document.getElementById('notes').textContent"
    page.wait_until(f"{notes}.includes('new: no figures yet') && {notes}.includes('config.toml')")
    photograph(page, "runs", pictures)
    page.look("light", 1200, 900)
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
    page.wait_until(f"{CHART} === null")
    page.evaluate(f"{BUTTONS}[0].click()")
    page.wait_until(f"{CHART} !== null && {LEGEND}.startsWith('happo (4 runs),mappo (4 runs) (hidden)')")


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
            file.write(json.dumps({"kind": "iteration", **step, "actors": 2, "reward/alive": 1, "agent0/loss": 1 / (1 + k + seed)}) + "\n")
            file.write(json.dumps({"kind": "evaluation", **step, "mean": seed * k}) + "\n")


def hover(page: Tab) -> None:
    """Values at the pointer are shown."""
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
        finished(page, pathlib.Path(place) / "run", pictures)
        several(page, pathlib.Path(place) / "several", pictures)
    print("a browser shows a live run, says when its learner is gone, and continues; and it shows a finished run and several runs")


if __name__ == "__main__":
    main()
