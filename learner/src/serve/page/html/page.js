// The page: what is shown, in the fragment of the address, and requests for it.

const STATUS_MILLIS = 1000, CURVES_MILLIS = 3000, TIMEOUT_MILLIS = 6000, PACE_MILLIS = 60000, FRAGMENT_MILLIS = 400;
const TABS = ["overview", "metrics", "settings"];

/// What is shown, as text by name. What differs from these defaults is in the fragment.
const DEFAULTS = {
  tab: "overview", filter: "", open: "Policies and values", hidden: "", group: "", smoothing: "0", zoom: "",
  run: "", policies: "", episode: "0", camera: "30,25,1", time: "",
};

let view = {...DEFAULTS}, writing = null, smoothing = 0, zoom = null, drawn = new Map(), meanings = new Map();
let runs = [], facts = null, factsOf = null, filmOf = null, looks = [], curvesAt = -Infinity, lostAt = null;

const list = (text) => text ? text.split("\n") : [];

/// Reads the view from the fragment.
function restore() {
  const given = Object.fromEntries(new URLSearchParams(location.hash.slice(1)));
  view = Object.fromEntries(Object.entries(DEFAULTS).map(([name, value]) => [name, given[name] ?? value]));
  if (!TABS.includes(view.tab)) view.tab = DEFAULTS.tab;
  const isStill = view.time !== "" || matchMedia("(prefers-reduced-motion: reduce)").matches;
  seconds = Math.max(0, Number(view.time) || 0);
  playing = !isStill;
  byId("play").textContent = playing ? "pause" : "play";
  byId("filter").value = view.filter;
  byId("smoothing").value = view.smoothing;
  byId("group").checked = view.group !== "";
  for (const details of document.querySelectorAll("details[data-group]")) details.open = list(view.open).includes(details.dataset.group);
  show(true);
}

/// Changes the view, and soon the fragment: browsers refuse more than three changes in a second, and a drag has many.
function change(changed) {
  Object.assign(view, changed);
  writing ??= setTimeout(writeFragment, FRAGMENT_MILLIS);
  if (Object.keys(changed).some((name) => !["camera", "time"].includes(name))) show(true);
}

function writeFragment() {
  writing = null;
  const different = Object.entries(view).filter(([name, value]) => value !== DEFAULTS[name]);
  const fragment = new URLSearchParams(different).toString();
  if (fragment !== location.hash.slice(1)) history.replaceState(null, "", fragment ? `#${fragment}` : location.pathname);
}

/// Shows the view of what is known; `all`: also the chart under the pointer.
function show(all) {
  const share = Number(view.smoothing), ends = view.zoom.split(",").map(Number);
  smoothing = share > 0 && share < 1 ? share : 0;
  zoom = ends.length === 2 && ends[0] < ends[1] ? ends : null;
  byId("smoothed").textContent = smoothing || "off";
  for (const tab of TABS) {
    const isShown = tab === view.tab;
    byId(tab).hidden = !isShown;
    byId(`tab-${tab}`).setAttribute("aria-selected", isShown);
    byId(`tab-${tab}`).tabIndex = isShown ? 0 : -1;
  }
  byId("drawing").hidden = view.tab === "settings";
  const found = entries();
  drawn = charts(found);
  showRuns(found);
  showReturns(all);
  showGroups(all);
  showEpisodes();
  showFacts();
}

function showReturns(all) {
  const shown = [...drawn.values()].filter((chart) => GROUPS[0][1].test(chart.title));
  shown.sort((a, b) => a.title < b.title ? -1 : 1);
  if (view.tab === "overview") showCharts(byId("returns"), shown, all);
}

// Metrics in groups that can be folded; with a filter, all groups are open.

function showGroups(all) {
  if (view.tab !== "metrics") return;
  const words = view.filter.toLowerCase().replaceAll("_", " ").split(" ").filter(Boolean);
  const matches = (chart) => words.every((word) => chart.title.toLowerCase().replaceAll("_", " ").includes(word));
  const wanted = [...drawn.values()].filter((chart) => matches(chart) && !GROUPS[0][1].test(chart.title));
  wanted.sort((a, b) => a.title < b.title ? -1 : 1);
  // From the last group in GROUPS, which is the first on the page.
  for (const [title] of [...GROUPS.slice(1)].reverse()) {
    const group = byId(`group ${title}`) ?? newGroup(title);
    const own = wanted.filter((chart) => GROUPS.find(([, belongs]) => belongs.test(chart.title))[0] === title);
    const [constant, moving] = [own.filter(isConstant), own.filter((chart) => !isConstant(chart))];
    group.hidden = !own.length;
    group.open = words.length > 0 || list(view.open).includes(title);
    group.querySelector(".count").textContent = moving.length;
    if (group.open) showCharts(group.querySelector(".charts"), moving, all);
    group.querySelector(".constants").textContent = constant.length ? `constant: ${constant.map(inWords).join("; ")}` : "";
  }
  byId("matches").textContent = words.length ? `${wanted.length} of ${drawn.size} metrics` : "";
}

function newGroup(title) {
  const summary = element("summary", {}, `${title} (`, element("span", {class: "count"}), ")");
  const parts = [summary, element("div", {class: "charts"}), element("p", {class: "constants quiet"})];
  const group = element("details", {id: `group ${title}`, "data-group": title}, ...parts);
  byId("groups").append(group);
  fold(group);
  return group;
}

/// Notes a click on the summary of a group in the view.
function fold(group) {
  group.querySelector("summary").onclick = (event) => {
    event.preventDefault();
    const {group: title} = group.dataset, others = list(view.open).filter((other) => other !== title);
    group.open = !group.open;
    change({open: (group.open ? [...others, title] : others).join("\n")});
  };
}

/// The value of a metric that does not change, or its values if those of its lines differ.
function inWords({title, lines}) {
  return `${title.replaceAll("_", " ")} ${[...new Set(lines.map((line) => short(line.figures[0])))].join(", ")}`;
}

// The legend of several runs: a button for each run, or for the runs that differ only in their seed.

function entries() {
  const found = new Map(), hidden = list(view.hidden);
  for (const run of runs) {
    const key = view.group && run.group !== null ? `group ${run.group}` : `run ${run.name}`;
    found.set(key, [...found.get(key) ?? [], run]);
  }
  return [...found.values()].map((members, place) => {
    const shown = members.filter((run) => !hidden.includes(run.name));
    const count = shown.length && shown.length < members.length ? `${shown.length} of ${members.length}` : members.length;
    const name = members.length > 1 ? `${members[0].group} (${count} runs)` : members[0].name;
    return {name, place, runs: members, shown};
  });
}

function showRuns(found) {
  const legend = byId("runs"), groups = runs.map((run) => run.group).filter((group) => group !== null);
  byId("several").hidden = runs.length < 2;
  byId("grouping").hidden = new Set(groups).size === groups.length;
  // The same elements as before, so that the keyboard stays at its place.
  while (legend.children.length > found.length) legend.lastChild.remove();
  while (legend.children.length < found.length) legend.append(element("button", {type: "button"}));
  found.forEach(({name, runs: members, shown, place}, i) => {
    const button = legend.children[i];
    button.setAttribute("aria-pressed", shown.length > 0);
    button.replaceChildren(element("i", {style: key(place)}), name);
    button.title = members.map((run) => run.name).join("\n");
    button.onclick = () => {
      const names = members.map((run) => run.name), others = list(view.hidden).filter((other) => !names.includes(other));
      change({hidden: (shown.length ? [...others, ...names] : others).join("\n")});
    };
  });
  const note = (run) => run.trouble ? element("li", {class: "bad"}, `${run.name}: ${run.trouble}`)
    : Object.keys(run.curves).length ? null : element("li", {}, `${run.name}: no figures yet`);
  byId("notes").replaceChildren(...runs.map(note).filter((made) => made));
  options(byId("chosen"), runs.map((run) => [run.name, run.name]), chosen()?.name);
}

/// The colour of a run in the legend; with stripes if its curve has dashes.
function key(index) {
  const stripes = `repeating-linear-gradient(90deg, ${colour(index)} 0 3px, transparent 3px 5px)`;
  return {background: index < COLOURS ? colour(index) : stripes};
}

/// Fills a selection, which stays as it is if nothing changes, so that it can be open meanwhile.
function options(select, wanted, value) {
  const known = [...select.options].map((option) => [option.value, option.text]);
  if (JSON.stringify(known) !== JSON.stringify(wanted)) {
    select.replaceChildren(...wanted.map(([name, text]) => element("option", {value: name}, text)));
  }
  if (select.value !== value) select.value = value ?? "";
}

/// The run whose robot and settings are shown: that of the view, or else the first one with an episode.
const chosen = () => runs.find((run) => run.name === view.run) ?? runs.find((run) => run.policies.length) ?? runs[0];

// The episode.

/// The policies whose episode is shown: those of the view, or else the newest.
function iteration({policies}) {
  const wanted = policies.find(([found]) => String(found) === view.policies) ?? policies.at(-1);
  return wanted?.[0];
}

function showEpisodes() {
  const run = chosen();
  if (!run) return;
  const {policies, episodes} = run, best = extent(policies.flatMap(([, mean]) => mean ?? []))[1];
  const text = (mean) => mean === null ? "" : `: return ${short(mean)}${mean === best && policies.length > 1 ? ", the best" : ""}`;
  const known = policies.map(([found, mean]) => [String(found), `iteration ${whole(found)}${text(mean)}`]).reverse();
  options(byId("policies"), [["", "the newest"], ...known], known.some(([found]) => found === view.policies) ? view.policies : "");
  byId("chooser").hidden = !policies.length;
  byId("choice").hidden = episodes < 2;
  byId("episode").max = episodes - 1;
  if (document.activeElement !== byId("episode")) byId("episode").value = view.episode;
}

/// Requests the episode that is to be shown, if it is not shown already. It may be requested again with the next look.
async function lookAtFilm() {
  const run = chosen(), found = iteration(run);
  if (found === undefined) return filmed(null, "no episode yet", null);
  if (view.tab !== "overview") return;
  const index = Math.max(0, Math.min(run.episodes - 1, Math.floor(Number(view.episode)) || 0));
  const path = `/api/film/${runs.indexOf(run)}/${found}/${index}`;
  if (path === filmOf) return;
  byId("filmed").textContent = "the episode is being played";
  const answer = await ask(path).catch(() => null);
  if (answer === null) return;
  if (answer.error) return filmed(null, answer.error, path);
  const {return: sum, steps, frame_secs: step, radii, ends} = answer, frames = ends.length / (6 * radii.length);
  const shown = frames > steps ? "" : `, of which ${duration(frames * step)} are shown`;
  filmed(answer, `iteration ${whole(found)}, episode ${index}: return ${short(sum)} in ${duration(steps * step)}${shown}`, path);
}

/// Shows a film or none, and says `words`; it was requested from `path`.
function filmed(found, words, path) {
  takeFilm(found);
  byId("filmed").textContent = words;
  filmOf = path;
}

// One run: its constants, and the progress of a live one.

async function lookAtFacts() {
  const run = chosen(), of = `${run.name} ${run.live?.status.incarnation}`;
  if (of === factsOf) return;
  facts = await ask(`/api/runs/${runs.indexOf(run)}`);
  factsOf = of;
  showFacts();
}

function showFacts() {
  if (!facts) return;
  const {command = "", settings = "", error} = facts;
  byId("unknown").hidden = !error;
  byId("unknown").textContent = error ?? "";
  byId("command").textContent = command;
  byId("toml").textContent = settings;
  const {git_commit: commit, version: number, rustc, config_sha256: hash, task, algorithm, seed} = facts.manifest ?? {};
  const rows = Object.entries({commit, version: number, compiler: rustc, "hash of the settings": hash}).filter(([, value]) => value);
  byId("manifest").replaceChildren(...rows.map(([name, value]) => element("tr", {}, element("th", {}, name), element("td", {}, value))));
  if (runs.length === 1) byId("what").textContent = task ? `${algorithm} on ${task}, seed ${seed}` : "";
}

/// Environment steps per second over the last looks, and so steadier than that of the last iteration.
function pace(steps) {
  looks.push([performance.now(), steps]);
  while (looks.length > 2 && looks[0][0] < performance.now() - PACE_MILLIS) looks.shift();
  const [first, last] = [looks[0], looks.at(-1)];
  return last[1] > first[1] ? 1000 * (last[1] - first[1]) / (last[0] - first[0]) : null;
}

function showLive({status, stage, waiting, secs, checkpoint, checkpoint_failures: failures}) {
  byId("live").hidden = false;
  const left = Math.max(0, facts.env_steps - status.env_steps), speed = pace(status.env_steps) ?? status.env_steps_per_sec;
  const working = new Set(status.leases.map((lease) => lease.actor)).size;
  const finished = status.iteration >= facts.iterations;
  const tile = (name, value, more = "") =>
    element("div", {class: "tile"}, name, element("b", {}, value), element("span", {class: "quiet"}, more));
  byId("tiles").replaceChildren(
    tile("Iteration", whole(status.iteration), `of ${whole(facts.iterations)}`),
    tile("Env steps", whole(status.env_steps), `of ${whole(facts.env_steps)}`),
    tile("Speed", speed ? whole(speed) : "-", "env steps/s"),
    tile("Time left", finished ? "none" : speed ? duration(left / speed) : "-", "at this speed"),
    tile("Actors", whole(status.actors), `${working} at work`),
    tile("Slots", `${status.complete_slots}/${status.slots}`, "complete"),
    tile("Checkpoint", checkpoint === null ? "-" : whole(checkpoint), failures ? `${failures} failed` : "iteration"),
    tile("Leased again", whole(status.leases_reissued), `${whole(status.messages_refused)} messages refused`),
  );
  const share = 100 * Math.min(1, status.env_steps / Math.max(1, facts.env_steps));
  byId("done").replaceChildren(element("div", {style: {width: `${share}%`, background: "var(--c0)"}}));
  if (secs) showSplit(secs);
  showLeases(status.leases);
  const now = waiting ? "waiting" : `running: ${stage}`;
  state(finished ? "finished" : now, Boolean(waiting));
  trouble(waiting ? `Waiting: ${waiting}.` : status.storage_degraded ? "The last checkpoint could not be written." : "");
}

function showSplit(secs) {
  const parts = ["collect", "refit", "update", "save"].map((name, i) => ({name, secs: secs[name], colour: colour(i)}));
  const total = parts.reduce((sum, part) => sum + part.secs, 0) || 1;
  byId("split").replaceChildren(...parts.map((part) =>
    element("div", {style: {width: `${100 * part.secs / total}%`, background: part.colour}})));
  byId("split-legend").replaceChildren(...parts.map((part) =>
    element("span", {}, element("i", {style: {background: part.colour}}), `${part.name} ${short(part.secs)} s`)));
}

function showLeases(leases) {
  const row = (tag, cells) => element("tr", {}, ...cells.map((cell) => element(tag, {}, String(cell))));
  const rows = leases.map((lease) => row("td", [
    lease.slot === null ? `episode ${lease.episode}` : `slot ${lease.slot}`, lease.actor, lease.chunks,
    `${lease.still_secs.toFixed(1)} s`,
  ]));
  const table = element("table", {}, row("th", ["lease", "actor", "chunks", "since the last"]), ...rows.slice(0, 8));
  byId("leases").replaceChildren(leases.length ? table : "no open leases");
  if (rows.length > 8) byId("leases").append(element("div", {class: "quiet"}, `and ${rows.length - 8} more`));
}

/// How far runs in folders are.
function showStored() {
  const ends = runs.flatMap((run) => Object.values(run.curves).map((curve) => curve[0].at(-1)));
  const steps = extent(ends)[1], planned = runs.length === 1 ? facts?.env_steps : undefined;
  const reached = `up to ${short(steps)} environment steps`;
  state(!ends.length ? "no figures yet" : planned === undefined ? reached
    : steps >= planned ? `finished: ${whole(steps)} environment steps` : `${short(steps)} of ${short(planned)} environment steps`, false);
  trouble(runs.length === 1 && runs[0].trouble ? `${runs[0].trouble}.` : "");
}

function state(words, bad) {
  byId("state").textContent = words;
  byId("state").className = bad ? "bad" : "";
}

function trouble(words) {
  byId("trouble").hidden = !words;
  byId("trouble").textContent = words;
}

// Requests, again and again.

async function ask(path) {
  const answer = await fetch(path, {signal: AbortSignal.timeout(TIMEOUT_MILLIS)});
  if (!answer.ok) throw new Error(`${path}: ${answer.status}`);
  return answer.json();
}

async function look() {
  const found = (await ask("/api/runs")).runs, [live] = found.map((run) => run.live);
  const isOther = found[0].name !== runs[0]?.name || live?.status.incarnation !== runs[0].live?.status.incarnation;
  if (isOther) [runs, looks, curvesAt] = [[], [], -Infinity];
  runs = found.map((run, i) => ({...run, curves: runs[i]?.curves ?? {}, curvesVersion: runs[i]?.curvesVersion}));
  byId("name").textContent = runs.length === 1 ? runs[0].name : `${runs.length} runs`;
  document.title = `${byId("name").textContent} - s2mia`;
  const now = performance.now(), changed = runs.filter((run) => run.version !== run.curvesVersion);
  if (changed.length && (!live || now - curvesAt > CURVES_MILLIS)) {
    for (const run of changed) {
      const {curves, version} = await ask(`/api/curves/${runs.indexOf(run)}`);
      Object.assign(run, {curves, curvesVersion: version});
    }
    curvesAt = now;
    show(false);
  } else {
    showEpisodes();
  }
  await lookAtFacts();
  if (live) showLive(live); else showStored();
  await lookAtFilm();
}

async function keepLooking() {
  try {
    if (!meanings.size) meanings = explanations(await (await fetch("/metrics.md")).text());
    await look();
    lostAt = null;
    document.body.classList.remove("stale");
  } catch {
    lostAt ??= new Date();
    document.body.classList.add("stale");
    state("disconnected", true);
    trouble(`Disconnected since ${lostAt.toLocaleTimeString()}: the program does not answer. The page continues when it does; ` +
      "`s2mia page` and the folder of a run show it without its program.");
  }
  setTimeout(keepLooking, STATUS_MILLIS);
}

// Controls.

function control() {
  for (const tab of TABS) {
    byId(`tab-${tab}`).onclick = () => change({tab});
    byId(`tab-${tab}`).onkeydown = ({key}) => {
      const next = TABS[(TABS.indexOf(tab) + {ArrowRight: 1, ArrowLeft: TABS.length - 1}[key]) % TABS.length];
      if (!next) return;
      change({tab: next});
      byId(`tab-${next}`).focus();
    };
  }
  byId("filter").oninput = (event) => change({filter: event.target.value});
  byId("smoothing").oninput = (event) => change({smoothing: event.target.value});
  byId("group").onchange = (event) => change({group: event.target.checked ? "1" : ""});
  byId("chosen").onchange = (event) => change({run: event.target.value, policies: "", episode: "0"});
  byId("policies").onchange = (event) => change({policies: event.target.value});
  byId("episode").onchange = (event) => change({episode: event.target.value || "0"});
  byId("save").onclick = () => {
    const href = URL.createObjectURL(new Blob([table()], {type: "text/csv"}));
    element("a", {href, download: "curves.csv"}).click();
    setTimeout(() => URL.revokeObjectURL(href), TIMEOUT_MILLIS);
  };
  fold(byId("work"));
  controlRobot();
  onhashchange = restore;
}

control();
restore();
keepLooking();
requestAnimationFrame(animate);
