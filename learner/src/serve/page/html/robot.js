// The robot: capsules in the colours of the agents that drive them, and a camera that follows the root.

let film = null, playing = true, seconds = 0, painted = 0;

/// Takes a film, or `null` for none: its frames in metres, what never moves, and the size of the robot around its root.
function takeFilm(found) {
  byId("film").hidden = !found;
  film = null;
  if (!found) return;
  const capsules = found.radii.length, all = found.ends;
  const frames = Array.from({length: all.length / (6 * capsules)}, (_, frame) =>
    found.radii.map((_, i) => all.slice(6 * (frame * capsules + i), 6 * (frame * capsules + i + 1)).map((mm) => mm / 1e3)));
  const moves = found.radii.map((_, i) => frames.some((frame) => frame[i].some((at, axis) => at !== frames[0][i][axis])));
  const isRobot = moves.some(Boolean) ? moves : moves.map(() => true);
  const distances = frames.flatMap((frame) => {
    const root = middle(frame[0]);
    return frame.filter((_, i) => isRobot[i]).flatMap((ends) =>
      [ends.slice(0, 3), ends.slice(3)].map((end) => Math.hypot(...end.map((at, axis) => at - root[axis]))));
  });
  const height = frames.reduce((sum, frame) => sum + middle(frame[0])[2], 0) / frames.length;
  film = {...found, frames, moves: isRobot, size: extent(distances)[1] + extent(found.radii)[1], height};
  const agents = [...new Set(found.drivers)].filter((agent) => agent !== null).sort((a, b) => a - b);
  byId("film-legend").replaceChildren(
    ...agents.map((agent) => element("span", {}, element("i", {style: {background: colour(agent)}}), `agent ${agent}`)));
  byId("time").max = filmSecs().toFixed(2);
  byId("time").step = found.frame_secs;
}

const middle = ([x1, y1, z1, x2, y2, z2]) => [(x1 + x2) / 2, (y1 + y2) / 2, (z1 + z2) / 2];
/// Duration of the film, seconds.
const filmSecs = () => (film.frames.length - 1) * film.frame_secs;

function animate(now) {
  requestAnimationFrame(animate);
  const passed = Math.min(0.1, (now - painted) / 1e3);
  painted = now;
  if (!film || !byId("film").offsetParent) return;
  if (playing) seconds = filmSecs() ? (seconds + passed) % filmSecs() : 0;
  seconds = Math.min(seconds, filmSecs());
  const at = seconds / film.frame_secs, first = Math.min(Math.floor(at), film.frames.length - 1);
  const next = film.frames[Math.min(first + 1, film.frames.length - 1)];
  paint(film.frames[first].map((ends, i) => ends.map((from, axis) => between(from, next[i][axis], at - first))));
  if (document.activeElement !== byId("time") || playing) byId("time").value = seconds;
  byId("moment").textContent = `${seconds.toFixed(2)} of ${filmSecs().toFixed(2)} s`;
}

/// Paints one frame: `[capsules, 6]`, metres.
function paint(capsules) {
  const canvas = document.querySelector("canvas"), brush = canvas.getContext("2d"), style = getComputedStyle(document.body);
  const dots = devicePixelRatio || 1, [width, height] = [canvas.clientWidth, canvas.clientHeight];
  if (canvas.width !== Math.round(width * dots)) [canvas.width, canvas.height] = [width, height].map((size) => Math.round(size * dots));
  brush.setTransform(dots, 0, 0, dots, 0, 0);
  brush.clearRect(0, 0, width, height);
  const [x, y] = middle(capsules[0]), project = projection([x, y, film.height], [width, height]);
  const line = (from, to, stroke, thick) => {
    brush.strokeStyle = stroke;
    brush.lineWidth = Math.max(1, thick);
    brush.beginPath();
    brush.moveTo(from[0], from[1]);
    // Some browsers draw no cap of a line without length.
    brush.lineTo(to[0], to[1] + 0.01);
    brush.stroke();
  };
  brush.lineCap = "round";
  floor(brush, line, [x, y], project, (name) => style.getPropertyValue(name));
  const ends = capsules.map((capsule, i) => ({
    from: project(capsule.slice(0, 3)), to: project(capsule.slice(3)), thick: 2 * film.radii[i] * project.scale, i,
    flat: [project([capsule[0], capsule[1], 0]), project([capsule[3], capsule[4], 0])],
  }));
  for (const one of ends.filter((one) => film.moves[one.i])) line(...one.flat, style.getPropertyValue("--shade"), one.thick);
  // What never moves is behind the robot: a long bar has no single distance.
  const depth = (one) => film.moves[one.i] ? one.from[2] + one.to[2] : 1e9;
  for (const one of ends.sort((a, b) => depth(b) - depth(a))) {
    const driver = film.drivers[one.i];
    line(one.from, one.to, style.getPropertyValue("--ink"), one.thick);
    line(one.from, one.to, style.getPropertyValue(driver === null ? "--quiet" : `--c${driver % COLOURS}`), one.thick - 3);
  }
}

/// Camera at infinity: maps a point in the world, metres, to pixels and its distance along the view.
function projection(centre, [width, height]) {
  const [azimuth, elevation, zoom] = camera(), [a, e] = [azimuth, elevation].map((degrees) => degrees * Math.PI / 180);
  const [ca, sa, ce, se] = [Math.cos(a), Math.sin(a), Math.cos(e), Math.sin(e)];
  const scale = zoom * 0.42 * Math.min(width, height) / film.size;
  const project = (point) => {
    const [x, y, z] = point.map((at, axis) => at - centre[axis]);
    const up = (ca * y - sa * x) * se + z * ce;
    return [width / 2 + scale * (ca * x + sa * y), height / 2 - scale * up, (ca * y - sa * x) * ce - z * se];
  };
  return Object.assign(project, {scale});
}

/// Lines at round distances around the robot, with metres along x at the edge that is nearer to the viewer.
function floor(brush, line, [x, y], project, named) {
  const gap = ticks(0, film.size * 2 / camera()[2], 3)[1], cells = 4, [left, front] = [x, y].map((at) => Math.round(at / gap) * gap);
  const around = Array.from({length: 2 * cells + 1}, (_, k) => (k - cells) * gap);
  for (const at of around) {
    line(project([left + at, front - cells * gap, 0]), project([left + at, front + cells * gap, 0]), named("--line"), 1);
    line(project([left - cells * gap, front + at, 0]), project([left + cells * gap, front + at, 0]), named("--line"), 1);
  }
  const edges = [front - gap, front + gap], near = edges.reduce((a, b) => project([left, b, 0])[1] > project([left, a, 0])[1] + 1e-9 ? b : a);
  brush.fillStyle = named("--quiet");
  brush.font = "12px system-ui, sans-serif";
  brush.textAlign = "center";
  for (const at of around) {
    const [across, down] = project([left + at, near, 0]);
    brush.fillText(`${short(+(left + at).toFixed(6))} m`, across, down + 15);
  }
}

// The camera: azimuth and elevation in degrees, and the size.

/// The camera of the view, or three-quarter if that is damaged.
function camera() {
  const found = view.camera.split(",").map(Number);
  return found.length === 3 && found.every(Number.isFinite) && found[2] > 0 ? found : DEFAULTS.camera.split(",").map(Number);
}

function turn(azimuth, elevation, larger) {
  const [a, e, zoom] = camera(), clamp = (low, value, high) => Math.min(high, Math.max(low, value));
  const turned = [((a + azimuth) % 360 + 360) % 360, clamp(0, e + elevation, 90), clamp(0.1, zoom * larger, 10)];
  change({camera: turned.map((value) => +value.toFixed(2)).join()});
}

function play(on) {
  playing = on;
  byId("play").textContent = on ? "pause" : "play";
  change({time: on || !film ? "" : seconds.toFixed(2)});
}

function controlRobot() {
  const canvas = document.querySelector("canvas");
  canvas.onpointerdown = (event) => canvas.setPointerCapture(event.pointerId);
  canvas.onpointermove = (event) => {
    if (event.buttons) turn(-event.movementX * 0.4, event.movementY * 0.4, 1);
  };
  const keys = {
    ArrowLeft: () => turn(5, 0, 1), ArrowRight: () => turn(-5, 0, 1), ArrowUp: () => turn(0, 5, 1), ArrowDown: () => turn(0, -5, 1),
    "+": () => turn(0, 0, 1.2), "-": () => turn(0, 0, 1 / 1.2), " ": () => play(!playing),
  };
  canvas.onkeydown = (event) => {
    if (!keys[event.key] || event.ctrlKey || event.metaKey) return;
    event.preventDefault();
    keys[event.key]();
  };
  for (const button of document.querySelectorAll("[data-camera]")) button.onclick = () => change({camera: button.dataset.camera});
  byId("closer").onclick = keys["+"];
  byId("farther").onclick = keys["-"];
  byId("play").onclick = () => play(!playing);
  byId("time").oninput = (event) => { seconds = Number(event.target.value); play(false); };
}
