"""A real browser looks at a real run: `cargo build && python3 tests/tools/page.py`.

Needs Chromium (Debian's package chromium). The curves must appear, in light and dark; when the learner is killed the page must
say so, and when it comes back on the same port the page must go on by itself, with the curves from the start of the run.
`--screenshots FOLDER` keeps pictures. Ends with 0 if all of it holds, and with 3 where
no Debian package can be had.
"""

import argparse
import pathlib
import tempfile

from browser import Tab, tab
from runs import free_port, training

STATE = "document.getElementById('state').textContent"
CURVES = "document.querySelectorAll('figure path').length"
POINTS = "(document.querySelector('[id=\"chart training return\"] path')?.getAttribute('d').length ?? 0)"
# Two looks at the film differ: the robot moves.
MOVES = "((now) => { const moved = window.seen !== undefined && window.seen !== now; window.seen = now; return moved; })" \
    "(document.querySelector('canvas').toDataURL())"
ITERATION = "Number(document.querySelector('#tiles b')?.textContent.replace(/,/g, '') ?? 0)"


def watch(page: Tab, folder: pathlib.Path, pictures: pathlib.Path | None) -> None:
    address = f"127.0.0.1:{free_port()}"
    with training(folder, address) as learner:
        page.show(f"http://{address}/")
        page.wait_until(f"{CURVES} > 10 && {POINTS} > 40 && {ITERATION} > 60")
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
    print("a browser shows a run, says when its learner is gone, and goes on with the next one")


if __name__ == "__main__":
    main()
