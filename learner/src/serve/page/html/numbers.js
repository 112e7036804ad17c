"use strict";
// Elements, numbers and times.

const COLOURS = 8;
const byId = (id) => document.getElementById(id);
const svgSpace = new DOMParser().parseFromString("<svg></svg>", "text/html").querySelector("svg").namespaceURI;

function element(tag, attributes = {}, ...children) {
  const drawn = ["svg", "g", "path", "line", "text", "circle", "polygon", "rect"].includes(tag);
  const made = drawn ? document.createElementNS(svgSpace, tag) : document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (name === "style") Object.assign(made.style, value); else made.setAttribute(name, value);
  }
  made.append(...children);
  return made;
}

const colour = (index) => `var(--c${index % COLOURS})`;
const whole = (value) => Math.round(value).toLocaleString("en");
const between = (a, b, share) => a + (b - a) * share;

function short(value) {
  const size = Math.abs(value);
  if (size >= 999950) return `${+(value / 1e6).toPrecision(4)}M`;
  if (size >= 1e4) return `${+(value / 1e3).toPrecision(4)}k`;
  return size > 0 && size < 1e-3 ? value.toExponential(1) : `${+value.toPrecision(4)}`;
}

function duration(secs) {
  if (secs < 90) return `${Math.round(secs)} s`;
  const minutes = Math.round(secs / 60);
  return minutes < 90 ? `${minutes} min` : `${Math.floor(minutes / 60)}h ${minutes % 60}m`;
}

/// Round numbers within a range, about `count` of them.
function ticks(low, high, count) {
  const rough = (high - low) / count, power = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 5, 10].map((times) => times * power).find((size) => size >= rough);
  const found = [];
  for (let at = Math.ceil(low / step) * step; at <= high + step * 1e-9; at += step) found.push(at);
  return found.map((at) => Math.abs(at) < step * 1e-9 ? 0 : at);
}

/// The smallest and the largest value; [0, 1] of none.
function extent(values) {
  if (!values.length) return [0, 1];
  return [values.reduce((a, b) => Math.min(a, b)), values.reduce((a, b) => Math.max(a, b))];
}

// The curves of a legend entry: mean, lowest and highest.

/// Mean, lowest and highest figure of several curves, from their latest start to their earliest end, there and at the points of the
/// curve that has the fewest in between: curves of different lengths are thinned out differently.
function together(curves) {
  if (curves.length === 1) return {steps: curves[0][0], figures: curves[0][1]};
  const first = Math.max(...curves.map(([steps]) => steps[0])), last = Math.min(...curves.map(([steps]) => steps.at(-1)));
  const inside = curves.map(([steps]) => steps.filter((at) => at > first && at < last));
  const inner = inside.reduce((a, b) => b.length < a.length ? b : a);
  const steps = first < last ? [first, ...inner, last] : first === last ? [first] : [];
  const figures = curves.map((curve) => interpolated(curve, steps)), at = steps.map((_, k) => figures.map((all) => all[k]));
  return {
    steps,
    figures: at.map((all) => all.reduce((a, b) => a + b) / all.length),
    low: at.map((all) => Math.min(...all)),
    high: at.map((all) => Math.max(...all)),
  };
}

/// The curve at `wanted` steps, which are within it in ascending order; straight between its points.
function interpolated([steps, figures], wanted) {
  let k = 0;
  return wanted.map((at) => {
    while (k + 1 < steps.length && steps[k + 1] <= at) k++;
    return steps[k] === at ? figures[k] : between(figures[k], figures[k + 1], (at - steps[k]) / (steps[k + 1] - steps[k]));
  });
}

/// Exponential moving average; its start is not pulled towards zero.
function smooth(figures, share) {
  if (!share) return figures;
  let sum = 0, weight = 0;
  return figures.map((figure) => {
    [sum, weight] = [share * sum + figure, share * weight + 1];
    return sum / weight;
  });
}

// What the metrics mean, by name: the rows of the tables of metrics in docs/PAPER.md.

function explanations(markdown) {
  const found = new Map(), tables = markdown.slice(markdown.indexOf("## What the metrics say"));
  const plain = (text) => text.replaceAll("\\|", "|").replaceAll("`", "").trim();
  for (const [, first, meaning] of tables.matchAll(/^\| (`.*?) \| (.*) \|$/gm)) {
    const names = [...first.matchAll(/`([^`]+)`/g)].map(([, name]) => name);
    const stem = names[0].replace(/_[a-z]+$/, "");
    for (const name of names) {
      found.set(name.startsWith("_") ? stem + name : name, names.length > 1 ? `${plain(first)}: ${plain(meaning)}` : plain(meaning));
    }
  }
  return found;
}
