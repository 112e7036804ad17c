// Charts: one for each metric. The page shows one run by its agents, or several runs by the entries of the legend.

const WIDTH = 330, HEIGHT = 178, LEFT = 46, RIGHT = 10, TOP = 8, BOTTOM = 32;

/// Groups of metrics in their order; the first that takes a metric keeps it.
const GROUPS = [
  ["Return", /^(evaluation|training) return$/],
  ["Reward terms", /^reward/],
  ["Surprise", /^surprise/],
  ["Influence", /^(influence|mi_|posterior|policy_nll)/],
  ["Time and health", /(_secs$|_per_sec$|^seconds|actors|refused|reissued|faults|failed|skipped)/],
  ["Policies and values", /./],
];

/// The chart of a metric, and its line's label in the charts of one run; `null` if it has none.
function placeOf(name, isOneRun) {
  const [, agent, ofAgent] = name.match(/^agent(\d+)\/(.*)$/) ?? [];
  if (name === "evaluation/mean") return {title: "evaluation return", label: "mean of its episodes", metric: "mean"};
  if (name.startsWith("evaluation/")) return null;
  if (name === "episode_return") return {title: "training return", label: "mean of the last episodes", metric: name};
  if (agent) return {title: ofAgent, label: `${agent}:`, place: Number(agent), metric: ofAgent};
  if (name.startsWith("reward/")) {
    return {title: isOneRun ? "reward terms in a step" : name, label: name.slice(7), metric: "reward/TERM"};
  }
  if (isOneRun && name.endsWith("_secs")) return {title: "seconds of an iteration", label: name.slice(0, -5), metric: "iteration_secs"};
  return {title: name, label: "", metric: name};
}

/// All charts by title, with the curves of the legend's entries.
function charts(entries) {
  const found = new Map(), isOneRun = entries.length === 1 && entries[0].runs.length === 1;
  for (const {name: entry, place, shown} of entries) {
    const gathered = new Map();
    for (const curves of shown.map((run) => run.curves)) {
      for (const [name, curve] of Object.entries(curves)) {
        const at = placeOf(name, isOneRun);
        if (!at) continue;
        if (!found.has(at.title)) found.set(at.title, {title: at.title, metric: at.metric, isOneRun, lines: []});
        const spread = name === "evaluation/mean" ? spreadOf(curves) : {};
        if (isOneRun) found.get(at.title).lines.push({label: at.label, place: at.place, ...together([curve]), ...spread});
        else gathered.set(at.title, [...gathered.get(at.title) ?? [], curve]);
      }
    }
    for (const [title, curves] of gathered) found.get(title).lines.push({label: entry, place, ...together(curves)});
  }
  for (const chart of found.values()) {
    // Curves without common steps have no mean.
    chart.lines = chart.lines.filter((line) => line.steps.length);
    if (!chart.lines.length) found.delete(chart.title);
    if (isOneRun) chart.lines.sort((a, b) => a.place - b.place);
    chart.lines.forEach((line, i) => { line.place ??= i; });
  }
  return found;
}

/// The smallest and largest return of each evaluation of a run.
function spreadOf(curves) {
  const [mean, low, high] = ["mean", "minimum", "maximum"].map((name) => curves[`evaluation/${name}`]?.[1]);
  return low && low.length === high?.length && low.length === mean.length ? {low, high} : {};
}

/// Whether no line of a chart ever changes.
const isConstant = (chart) => chart.lines.every(({figures}) => figures.every((figure) => figure === figures[0]));

/// A line as it is drawn: all its figures smoothed, then those within the zoom.
function seen(line) {
  const inside = line.steps.flatMap((at, k) => !zoom || (at >= zoom[0] && at <= zoom[1]) ? [k] : []);
  const pick = (values) => inside.map((k) => values[k]), smoothed = (values) => pick(smooth(values, smoothing));
  const band = line.low && {low: smoothed(line.low), high: smoothed(line.high)};
  return {...line, ...band, steps: pick(line.steps), raw: pick(line.figures), figures: smoothed(line.figures)};
}

function range(values) {
  const [low, high] = extent(values), size = Math.max(Math.abs(low), Math.abs(high));
  // Smoothing changes the last digits of a constant; ticks need a range that is wider than those.
  const room = high - low <= size * 1e-9 ? size * 0.1 || 1 : 0;
  return [low - room, high + room];
}

/// Draws a chart into its figure, whose caption stays, so that an open explanation does, too.
function draw(figure, all) {
  const chart = {...all, lines: all.lines.map(seen)};
  const values = chart.lines.flatMap((line) => [...line.figures, ...line.raw, ...line.low ?? [], ...line.high ?? []]);
  const [low, high] = range(values);
  const [first, last] = zoom ?? [0, Math.max(1, ...all.lines.map((line) => line.steps.at(-1) ?? 0))];
  const x = (steps) => LEFT + (WIDTH - LEFT - RIGHT) * (steps - first) / (last - first);
  const y = (value) => TOP + (HEIGHT - TOP - BOTTOM) * (high - value) / (high - low);
  const sheet = element("svg", {class: "drawing", viewBox: `0 0 ${WIDTH} ${HEIGHT}`, role: "img", "aria-label": chart.title});
  axes(sheet, [x, first, last], [y, low, high]);
  for (const {steps, low: lows, high: highs, place} of chart.lines.filter((line) => line.low)) {
    const outline = [...steps.map((at, k) => [at, highs[k]]), ...steps.map((at, k) => [at, lows[k]]).reverse()];
    const points = outline.map(([at, value]) => `${x(at).toFixed(1)},${y(value).toFixed(1)}`).join(" ");
    sheet.append(element("polygon", {points, style: {fill: colour(place), opacity: 0.18}}));
  }
  for (const line of chart.lines) {
    const path = (figures, style) => {
      const d = line.steps.map((at, k) => `${k ? "L" : "M"}${x(at).toFixed(1)} ${y(figures[k]).toFixed(1)}`).join("");
      sheet.append(element("path", {d, style: {fill: "none", strokeLinejoin: "round", ...style}}));
    };
    const stroke = colour(line.place), strokeDasharray = dashes(line.place);
    if (smoothing) path(line.raw, {stroke, strokeWidth: 1, opacity: 0.25});
    path(line.figures, {stroke, strokeWidth: 1.6, strokeDasharray});
    if (line.steps.length === 1) sheet.append(dot(x(line.steps[0]), y(line.figures[0]), line.place));
  }
  if (!figure.firstChild) figure.append(caption(chart));
  figure.replaceChildren(figure.firstChild, element("div", {class: "values"}), sheet);
  point(figure, sheet, chart, {x, y, first, last});
  showValues(figure, chart, (line) => line.steps.length - 1);
}

/// The title; it opens the explanation of the metric, which is also its tooltip.
function caption({title, metric, isOneRun, lines}) {
  const words = title.replaceAll("_", " ") + (isOneRun && lines[0].label.endsWith(":") ? ", by agent" : "");
  const meaning = meanings.get(metric);
  if (!meaning) return element("figcaption", {}, words);
  return element("figcaption", {}, element("details", {}, element("summary", {title: meaning}, words), element("p", {}, meaning)));
}

function axes(sheet, [x, first, last], [y, low, high]) {
  const rule = (x1, y1, x2, y2) => sheet.append(element("line", {x1, y1, x2, y2, style: {stroke: "var(--line)"}}));
  const word = (text, at, anchor) => sheet.append(element("text", {...at, "text-anchor": anchor}, text));
  for (const at of ticks(low, high, 4)) {
    rule(LEFT, y(at), WIDTH - RIGHT, y(at));
    word(short(at), {x: LEFT - 5, y: y(at) + 3.5}, "end");
  }
  for (const at of ticks(first, last, 4)) word(short(at), {x: x(at), y: HEIGHT - BOTTOM + 14}, "middle");
  word("environment steps", {x: (LEFT + WIDTH - RIGHT) / 2, y: HEIGHT - 4}, "middle");
}

/// Values under the pointer; a drag chooses the steps that all charts show, a double click all of them again.
function point(figure, sheet, chart, {x, y, first, last}) {
  const marks = element("g");
  sheet.append(marks);
  let from = null;
  const stepsAt = (event) => {
    const box = sheet.getBoundingClientRect(), inside = (event.clientX - box.left) / box.width * WIDTH;
    const share = (inside - LEFT) / (WIDTH - LEFT - RIGHT);
    return first + (last - first) * Math.min(1, Math.max(0, share));
  };
  sheet.onpointermove = (event) => {
    const steps = stepsAt(event);
    marks.replaceChildren(...chart.lines.flatMap((line) => {
      const k = nearest(line.steps, steps);
      return line.steps.length ? [dot(x(line.steps[k]), y(line.figures[k]), line.place)] : [];
    }));
    if (from !== null) {
      const [left, right] = [from, steps].map(x).sort((a, b) => a - b);
      const box = {x: left, y: TOP, width: right - left, height: HEIGHT - TOP - BOTTOM};
      marks.append(element("rect", {...box, style: {fill: "var(--ink)", opacity: 0.12}}));
    }
    showValues(figure, chart, (line) => nearest(line.steps, steps));
  };
  sheet.onpointerdown = (event) => {
    if (event.button) return;
    from = stepsAt(event);
    sheet.setPointerCapture(event.pointerId);
  };
  sheet.onpointerup = (event) => {
    const chosen = [from, stepsAt(event)].sort((a, b) => a - b);
    const wide = from !== null && x(chosen[1]) - x(chosen[0]) > 5;
    from = null;
    if (wide) change({zoom: chosen.map(Math.round).join()});
  };
  sheet.onpointercancel = () => { from = null; };
  sheet.ondblclick = () => change({zoom: ""});
  sheet.onpointerleave = () => { marks.replaceChildren(); showValues(figure, chart, (line) => line.steps.length - 1); };
}

/// Runs beyond the colours have dashes.
const dashes = (index) => index < COLOURS ? "none" : `${2 + 2 * Math.floor(index / COLOURS)} 2`;
const dot = (cx, cy, index) => element("circle", {cx, cy, r: 3, style: {fill: colour(index)}});

function nearest(steps, wanted) {
  let best = 0;
  steps.forEach((at, k) => { if (Math.abs(at - wanted) < Math.abs(steps[best] - wanted)) best = k; });
  return best;
}

/// The figures of all lines at the places that `index` chooses, in words above the chart.
function showValues(figure, chart, index) {
  const words = chart.lines.map((line) => {
    const value = line.steps.length ? short(line.figures[index(line)]) : "-";
    return element("span", {title: line.label, style: {color: colour(line.place)}}, chart.isOneRun ? `${line.label} ${value}`.trim() : value);
  });
  const at = chart.lines.flatMap((line) => line.steps.length ? [line.steps[index(line)]] : []);
  const [first, last] = extent(at).map(short);
  if (at.length) words.push(element("span", {class: "quiet"}, first === last ? `at ${first}` : `at ${first} to ${last}`));
  figure.querySelector(".values").replaceChildren(...words);
}

/// Draws these charts, and no others, under `parent`; the one under the pointer only with `all`.
function showCharts(parent, shown, all) {
  const keys = shown.map((chart) => `chart ${chart.title}`);
  for (const old of [...parent.children].filter((figure) => !keys.includes(figure.id))) old.remove();
  shown.forEach((chart, i) => {
    const known = byId(keys[i]), figure = known ?? element("figure", {id: keys[i]});
    if (parent.children[i] !== figure) parent.insertBefore(figure, parent.children[i] ?? null);
    if (all || !known || !figure.matches(":hover")) draw(figure, chart);
  });
}

/// What the charts show, one point a row.
function table() {
  const cell = (value) => /[",\n]/.test(value) ? `"${String(value).replaceAll('"', '""')}"` : value;
  const rows = [["figure", "line", "env_steps", "value", "smoothed", "lowest", "highest"]];
  for (const chart of drawn.values()) {
    for (const line of chart.lines.map(seen)) {
      const label = line.label.endsWith(":") ? `agent ${line.label.slice(0, -1)}` : line.label;
      const more = (k) => [smoothing ? line.figures[k] : "", line.low?.[k] ?? "", line.high?.[k] ?? ""];
      line.steps.forEach((at, k) => rows.push([chart.title, label, at, line.raw[k], ...more(k)]));
    }
  }
  return rows.map((row) => row.map(cell).join(",") + "\n").join("");
}
