// Small charts in SVG. Styles come from the style sheet, so that they follow light and dark.

const kSvg = 'http://www.w3.org/2000/svg';

export function shape(parent, tag, attributes, text) {
  const node = document.createElementNS(kSvg, tag);
  for (const [name, value] of Object.entries(attributes)) node.setAttribute(name, value);
  if (text !== undefined) node.textContent = text;
  parent.append(node);
  return node;
}

/** At most `count` round numbers from `low` to `high`. */
function ticks(low, high, count) {
  const raw = (high - low) / count;
  const power = 10 ** Math.floor(Math.log10(raw));
  const step = power * [1, 2, 5, 10].find((factor) => factor * power >= raw);
  const found = [];
  for (let k = Math.ceil(low / step); k * step <= high * (1 + 1e-12) + 1e-300; ++k) found.push(k * step);
  return found;
}

export function shortNumber(value, digits = 4) {
  if (value === null || !Number.isFinite(value)) return '–';
  const size = Math.abs(value);
  if (size > 0 && (size < 1e-3 || size >= 1e6)) return value.toExponential(digits - 1).replace(/\.?0+e/, 'e');
  return String(Number(value.toPrecision(digits)) + 0);
}

/** From the lowest to the highest of all lists, with a margin. */
export function rangeOf(lists) {
  let low = Infinity;
  let high = -Infinity;
  for (const list of lists)
    for (const value of list)
      if (Number.isFinite(value)) {
        low = Math.min(low, value);
        high = Math.max(high, value);
      }
  if (low > high) return [0, 1];
  const margin = (high - low || Math.abs(high) || 1) * 0.06;
  return [low - margin, high + margin];
}

/** An empty frame with axes; gives the group to draw in and the scales. `bottom`: with numbers below. */
function frame(svg, { x, y, title, bottom, xTitle, xTicks, yTicks = true }) {
  svg.replaceChildren();
  const width = svg.clientWidth || 400;
  const height = svg.clientHeight || 90;
  const area = { left: 60, right: width - 8, top: title ? 19 : 6, bottom: height - (bottom ? 20 : 5) };
  const px = (value) => area.left + ((value - x[0]) / (x[1] - x[0])) * (area.right - area.left);
  const py = (value) => area.bottom - ((value - y[0]) / (y[1] - y[0])) * (area.bottom - area.top);
  if (yTicks)
    for (const tick of ticks(y[0], y[1], Math.max(2, Math.floor((area.bottom - area.top) / 18)))) {
      shape(svg, 'line', { class: 'grid', x1: area.left, x2: area.right, y1: py(tick), y2: py(tick) });
      shape(svg, 'text', { x: area.left - 6, y: py(tick) + 4, 'text-anchor': 'end' }, shortNumber(tick));
    }
  if (bottom) {
    for (const [at, text] of xTicks ?? ticks(x[0], x[1], 6).map((tick) => [tick, shortNumber(tick)])) {
      if (px(at) > area.right - 70 && xTitle) continue;
      shape(svg, 'text', { x: px(at), y: height - 5, 'text-anchor': 'middle' }, text);
    }
    shape(svg, 'text', { x: area.right, y: height - 5, 'text-anchor': 'end' }, xTitle ?? '');
  }
  shape(svg, 'rect', { class: 'frame', x: area.left, y: area.top, width: area.right - area.left, height: area.bottom - area.top });
  if (title) shape(svg, 'text', { class: 'title', x: area.left, y: 13 }, title);
  return { px, py, area };
}

function path(xs, ys, px, py) {
  let text = '';
  for (let i = 0; i < Math.min(xs.length, ys.length); ++i)
    if (Number.isFinite(ys[i])) text += `${text ? 'L' : 'M'}${px(xs[i]).toFixed(1)} ${py(ys[i]).toFixed(1)}`;
  return text;
}

/** Lines over a common x axis. series: [{x, y, kind}] in the order of drawing. */
export function lineChart(svg, { x, y, title, bottom, xTitle, series }) {
  const { px, py } = frame(svg, { x, y, title, bottom, xTitle });
  for (const line of series) shape(svg, 'path', { class: line.kind, d: path(line.x, line.y, px, py) });
}

/** A control chart; marks the points that a rule names. `specification`: limits of another kind, where they are in sight. */
export function controlChart(svg, { centre, lower, upper, points, signals, specification = [] }, xTitle) {
  const y = rangeOf([points, [centre, lower, upper].filter((value) => value !== null)]);
  const xs = points.map((_, i) => i + 1);
  const each = Math.ceil(points.length / 12);
  const xTicks = xs.filter((x) => x % each === 0).map((x) => [x, String(x)]);
  const { px, py, area } = frame(svg, { x: [0.5, points.length + 0.5], y, bottom: true, xTicks, xTitle });
  const rule = (value, kind) => {
    if (value !== null) shape(svg, 'line', { class: kind, x1: area.left, x2: area.right, y1: py(value), y2: py(value) });
  };
  rule(centre, 'centre');
  rule(lower, 'limit');
  rule(upper, 'limit');
  for (const limit of specification) if (limit > y[0] && limit < y[1]) rule(limit, 'specification');
  shape(svg, 'path', { class: 'measured', d: path(xs, points, px, py) });
  const bad = new Set(signals.map((signal) => signal.at));
  points.forEach((value, i) => {
    if (value !== null) shape(svg, 'circle', { class: bad.has(i) ? 'point bad' : 'point', cx: px(i + 1), cy: py(value), r: bad.has(i) ? 5 : 3.2 });
  });
}

/** How often which values came, with the specification's limits, which are always in sight. */
export function distribution(svg, values, specification) {
  const known = values.filter(Number.isFinite);
  const x = rangeOf([known, specification]);
  const slots = Math.min(40, Math.max(12, Math.ceil(3 * Math.sqrt(known.length))));
  const counts = new Array(slots).fill(0);
  for (const value of known) ++counts[Math.min(slots - 1, Math.floor(((value - x[0]) / (x[1] - x[0])) * slots))];
  const { px, py, area } = frame(svg, { x, y: [0, Math.max(1, ...counts) * 1.1], yTicks: false, bottom: true });
  counts.forEach((count, slot) => {
    if (count === 0) return;
    const at = (edge) => px(x[0] + (edge / slots) * (x[1] - x[0]));
    shape(svg, 'rect', { class: 'bar', x: at(slot) + 1, width: at(slot + 1) - at(slot) - 2, y: py(count), height: area.bottom - py(count) });
  });
  for (const limit of specification)
    if (Number.isFinite(limit)) shape(svg, 'line', { class: 'specification', x1: px(limit), x2: px(limit), y1: area.top, y2: area.bottom });
  shape(svg, 'text', { x: area.left - 6, y: area.top + 12, 'text-anchor': 'end' }, 'brakes');
  shape(svg, 'text', { x: area.left - 6, y: area.top + 26, 'text-anchor': 'end' }, String(Math.max(...counts)));
}

/** How often the loop woke how late: powers of two on both axes' scales. bins: [[microseconds, ticks]]. */
export function histogram(svg, bins) {
  const counts = [];
  for (const [lateness, number] of bins) {
    const slot = lateness < 1 ? 0 : Math.floor(Math.log2(lateness)) + 1;
    counts[slot] = (counts[slot] ?? 0) + number;
  }
  const slots = Math.max(8, counts.length);
  const top = Math.max(1, ...counts.filter((count) => count > 0).map((count) => Math.log10(count))) * 1.1;
  const xTicks = Array.from({ length: slots }, (_, slot) => [slot, slot === 0 ? '0' : String(2 ** (slot - 1))]);
  const { px, py, area } = frame(svg, { x: [0, slots], y: [0, top], yTicks: false, bottom: true, xTicks, xTitle: 'late by µs' });
  for (let slot = 0; slot < slots; ++slot) {
    const count = counts[slot] ?? 0;
    if (count > 0) {
      const y = py(Math.max(0.06, Math.log10(count)));
      shape(svg, 'rect', { class: 'bar', x: px(slot) + 2, width: px(slot + 1) - px(slot) - 4, y, height: area.bottom - y });
    }
  }
  const below = area.bottom - 4;
  shape(svg, 'text', { x: area.left - 6, y: area.top + 12, 'text-anchor': 'end' }, 'ticks');
  shape(svg, 'text', { x: area.left - 6, y: below, 'text-anchor': 'end' }, '(log)');
}

/** One parameter between its limits, with an uncertainty band of two standard deviations. */
export function limitBar(svg, { value, sd, lower, upper }) {
  svg.replaceChildren();
  const width = svg.clientWidth || 160;
  const middle = 11;
  const span = upper - lower;
  const px = (at) => Math.min(width - 6, Math.max(6, width * 0.12 + ((at - lower) / span) * width * 0.76));
  shape(svg, 'rect', { class: 'band', x: px(lower), y: 3, width: px(upper) - px(lower), height: 16, rx: 3 });
  shape(svg, 'line', { class: 'nominal', x1: px((lower + upper) / 2), x2: px((lower + upper) / 2), y1: 3, y2: 19 });
  if (value === null || !Number.isFinite(value)) return;
  if (sd !== null) {
    const from = px(value - 2 * sd);
    const to = px(value + 2 * sd);
    shape(svg, 'line', { class: 'whisker', x1: from, x2: to, y1: middle, y2: middle });
    for (const end of [from, to]) shape(svg, 'line', { class: 'whisker', x1: end, x2: end, y1: middle - 5, y2: middle + 5 });
  }
  shape(svg, 'circle', { class: 'mark', cx: px(value), cy: middle, r: 6 });
}
