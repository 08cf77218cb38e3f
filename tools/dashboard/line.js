// The page of the line: drawn from /line.json (clampd.line_page/1) of the worker that served it; nobody else is asked anything.

import { limitBar, rangeOf, shape, shortNumber } from '/charts.js';
import { $, element, setText, unitText, utcText } from '/page.js';
import { parameterWords } from '/words.js';

const kEach_ms = 30000;
/** Longer than the archive may take, also on a machine that is busy. */
const kPatience_ms = 60000;
/** Days, what they are called, and their periods. */
const kSpans = [[1, '24 h', 'hour'], [7, '7 days', '6 hours'], [30, '30 days', 'day'], [90, '90 days', '3 days'], [365, '1 year', 'week']];
const kKinds = ['passed', 'failed', 'invalid'];
const kKindWords = ['pass', 'fail', 'error'];

// What is shown stands in the address, so that a screen on a wall keeps it.
const wanted = new URLSearchParams(location.search);
let line = null;
let asked = 0;
let answered = 0;

const spanWords = (days) => kSpans.find(([span]) => span === days)?.[1] ?? `${days} days`;
const periodWords = (days) => `each ${kSpans.find(([span]) => span === days)?.[2] ?? 'period'}`;
/** A sentence of the attribution as the page writes units and times. */
const findingText = (words) => unitText(words).replace(/(\d{4}-\d\d-\d\d)T(\d\d:\d\d):\d\dZ/g, '$1 $2 UTC');
const cardinal = (count, word) => `${count.toLocaleString('en')} ${word}${count === 1 ? '' : 's'}`;

function ageText(seconds) {
  if (seconds < 90) return `${Math.round(seconds)} s`;
  if (seconds < 5400) return `${Math.round(seconds / 60)} min`;
  if (seconds < 2 * 86400) return `${Math.round(seconds / 3600)} h`;
  return `${Math.round(seconds / 86400)} days`;
}

async function read() {
  const query = new URLSearchParams([...wanted].filter(([name]) => name === 'days' || name === 'part_number'));
  let response;
  try {
    response = await fetch(`/line.json?${query}`, { signal: AbortSignal.timeout(kPatience_ms) });
    const answer = await response.json();
    if (response.ok) return answer;
    throw new Error(answer.error ?? `status ${response.status}`);
  } catch (error) {
    if (error.name === 'TimeoutError') throw new Error(`The worker has not answered for ${kPatience_ms / 1000} s: its database hangs, or its machine has no time.`);
    if (!response) throw new Error(`No answer from the worker at ${location.host}: it has ended, or the network is cut.`);
    throw error;
  }
}

/** A later question makes an earlier one's answer void. */
async function refresh() {
  const mine = ++asked;
  try {
    const answer = await read();
    if (mine !== asked) return;
    line = answer;
    setText($('notices'), '');
    document.body.classList.remove('stale');
    show();
  } catch (error) {
    if (mine !== asked) return;
    const shown = line ? ` What is shown is of ${utcText(line.made)}.` : '';
    setText($('notices'), `${error.message}${shown} Trying again every ${kEach_ms / 1000} s.`);
    document.body.classList.add('stale');
    if (!line) setText($('about'), '');
  } finally {
    answered = Math.max(answered, mine);
  }
}

function want(name, value) {
  wanted.set(name, value);
  history.replaceState(null, '', `?${wanted}`);
  showChoices();
  refresh();
}

function showChoices() {
  const days = Number(wanted.get('days') ?? 30);
  for (const button of $('spans').children) button.setAttribute('aria-pressed', Number(button.value) === days);
  // Whoever chooses a part at this moment keeps the list.
  if (!line || document.activeElement === $('part')) return;
  const chosen = wanted.get('part_number') ?? line.part_number;
  const parts = line.part_numbers.map((part) => part.part_number);
  const options = (parts.includes(chosen) ? parts : [chosen, ...parts]).map((part) => {
    const found = line.part_numbers.find((one) => one.part_number === part);
    const option = element('option', { value: part, textContent: `${part || 'none given'} (${cardinal(found?.checks ?? 0, 'check')})` });
    option.selected = part === chosen;
    return option;
  });
  $('part').replaceChildren(...options);
}

function show() {
  showChoices();
  showAbout();
  const silentFirst = [...line.stations].sort((a, b) => b.silent - a.silent);
  $('stations').replaceChildren(...silentFirst.map(stationCard));
  drawStations();
  showFindings();
  showParameters();
  showWork();
}

function showAbout() {
  const silent = line.stations.filter((station) => station.silent).length;
  const found = allFindings().length;
  const pills = [];
  if (silent > 0) pills.push(element('span', { className: 'pill warn', textContent: cardinal(silent, 'silent station') }));
  if (found > 0) pills.push(element('span', { className: 'pill bad', textContent: cardinal(found, 'finding') }));
  if (silent + found === 0 && line.stations.length > 0) pills.push(element('span', { className: 'pill good', textContent: 'nothing to report' }));
  $('pills').replaceChildren(...pills);
  document.title = ['clampd line', silent > 0 && `${silent} silent`, found > 0 && cardinal(found, 'finding')].filter(Boolean).join(', ');
  if (line.stations.length === 0)
    return setText($('about'), `There is no check in the archive yet (${line.archive}). A station sends its checks there that has [postgresql] in its configuration.`);
  const last = Math.min(...line.stations.map((station) => station.last.age_s));
  const texts = [`${cardinal(line.checks, 'check')} in ${spanWords(line.days)}, the last one ${ageText(last)} ago`, `${utcText(line.made)} by the clock of ${line.archive}`];
  if (line.read_since) texts.push(`only the newest ${cardinal(line.checks, 'check')} were read, from ${utcText(line.read_since)} on: older ones are left out`);
  if (line.more_stations) texts.push(`the ${line.stations.length} stations with the newest checks; others are left out`);
  setText($('about'), `${texts.join('; ')}.`);
}

function drawing(kind) {
  const svg = document.createElementNS('http://www.w3.org/2000/svg', 'svg');
  svg.classList.add(kind);
  return svg;
}

function stationCard(station) {
  const { last } = station;
  const card = element('div', { className: station.silent ? 'station card silent' : 'station card' });
  card.dataset.station = station.station;
  const when = element('span', { textContent: `${ageText(last.age_s)} ago`, title: utcText(last.started) });
  const badge = element('span', { className: `badge ${last.verdict}`, textContent: last.verdict, title: last.reason });
  card.append(element('div', { className: 'top' }, element('h2', { textContent: station.station || 'no name' }), badge),
              element('div', { className: 'last' }, element('b', { textContent: last.serial || 'no serial', title: last.serial }), when),
              drawing('bars'), countsOf(station));
  if (station.silent) {
    const missed = station.missed === null ? `no check in ${spanWords(line.days)}` : `its share of the line would be ${Math.round(station.missed)} checks`;
    card.append(element('p', { className: 'alarm', textContent: `SILENT for ${ageText(last.age_s)}: ${missed}` }));
  }
  if (station.simulated > 0) card.append(element('div', { className: 'quiet', textContent: `${cardinal(station.simulated, 'check')} of SIMULATED brakes` }));
  return card;
}

function countsOf(station) {
  const rows = [[spanWords(line.days), station.span]];
  if (line.days > 1) rows.unshift(['24 h', station.day]);
  const head = [element('span'), ...kKinds.map((kind, i) => element('span', { className: 'quiet' }, element('i', { className: kind }), kKindWords[i]))];
  const cells = rows.flatMap(([words, counts]) => [words, ...kKinds.map((kind) => counts[kind].toLocaleString('en'))].map((textContent) => element('span', { textContent })));
  return element('div', { className: 'counts' }, ...head, ...cells);
}

/** Shades what was not read; `at` gives the place of a share of the span. */
function shadeUnread(svg, since, width, height) {
  if (!since) return;
  const share = (new Date(since) - new Date(line.since)) / (1000 * line.period_s * line.periods);
  shape(svg, 'rect', { class: 'unread', x: 0, y: 0, width: Math.max(0, Math.min(1, share)) * width, height });
}

/** How many checks ended how in each period, on one scale for all stations. */
function drawStations() {
  const top = Math.max(1, ...line.stations.flatMap((station) => station.periods.map((counts) => counts[0] + counts[1] + counts[2])));
  for (const card of $('stations').children) {
    const station = line.stations.find((one) => one.station === card.dataset.station);
    const svg = card.querySelector('svg');
    svg.replaceChildren();
    const width = svg.clientWidth || 220;
    const height = svg.clientHeight || 46;
    shadeUnread(svg, line.read_since, width, height);
    shape(svg, 'line', { class: 'base', x1: 0, x2: width, y1: height - 0.5, y2: height - 0.5 });
    station.periods.forEach((counts, period) => {
      const each = width / line.periods;
      let y = height - 1;
      counts.forEach((count, kind) => {
        if (count === 0) return;
        const tall = Math.max(1, (count / top) * (height - 2));
        y -= tall;
        shape(svg, 'rect', { class: kKinds[kind], x: period * each + 0.5, width: Math.max(1, each - 1.5), y, height: tall });
      });
    });
    shape(svg, 'title', {}, `checks of ${periodWords(line.days)}, at most ${top}`);
  }
}

const allFindings = () => line.attribution?.parameters.flatMap((parameter) => parameter.findings.map((finding) => ({ ...finding, parameter: parameter.name }))) ?? [];

function showFindings() {
  $('found').hidden = line.stations.length === 0;
  const part = line.part_number ? `part number ${line.part_number}` : 'brakes without a part number';
  const say = (className, textContent) => element('p', { className, textContent });
  if (!line.attribution)
    return $('findings').replaceChildren(say('unknown', `${cardinal(line.measured, 'valid check')} of ${part} in ${spanWords(line.days)}: with fewer than ten nothing can be attributed. Choose a longer time.`));
  const found = allFindings();
  const lines = found.map((finding) => say('finding', findingText(finding.words)));
  if (found.length === 0) lines.push(say('', `${part}: no station and no batch differs or changes by more than the others do.`));
  for (const parameter of line.attribution.parameters)
    if (!parameter.converged) lines.push(say('unknown', `${parameter.name}: the spread could not be divided among its causes; what is said of it is not to be relied on.`));
  if (line.attribution.cannot_tell) lines.push(say('unknown', line.attribution.cannot_tell));
  const left = line.simulated_left_out > 0 ? `, ${cardinal(line.simulated_left_out, 'check')} of simulated brakes left out` : '';
  const chance = `Where nothing differs, something is found with a probability of ${100 * line.attribution.false_alarms} %.`;
  lines.push(say('quiet', `From ${cardinal(line.attribution.checks, 'valid check')} of ${cardinal(line.attribution.brakes, 'brake')} of ${part}${left}. ${chance}`));
  $('findings').replaceChildren(...lines);
}

function showParameters() {
  $('cards').replaceChildren(...line.parameters.map(parameterCard), $('work'));
  $('key').hidden = line.parameters.length === 0;
  setText($('key'), `Of each brake the last valid check at each station counts. Left: mean ± 2 sd of the brakes between the limits (green). Right: mean of ${periodWords(line.days)} ± 2 sd, on one scale for all stations; dashed: the mean of all.` +
    (line.measured_since ? ` Only checks from ${utcText(line.measured_since)} on were read: older ones are left out.` : ''));
  drawParameters();
}

/** From the lowest to the highest mean of a period with its uncertainty, over all stations. */
function driftRange(parameter) {
  const known = parameter.stations.flatMap(({ periods }) => periods.mean.flatMap((mean, i) =>
    mean === null ? [] : [mean, ...(periods.brakes[i] > 1 && periods.sd[i] !== null ? [mean - 2 * periods.sd[i], mean + 2 * periods.sd[i]] : [])]));
  return rangeOf([known]);
}

function parameterCard(parameter) {
  const { name, unit, lower, upper } = parameter;
  const findings = allFindings().filter((finding) => finding.parameter === name && finding.station !== undefined);
  const [low, high] = driftRange(parameter);
  const limits = lower !== null && upper !== null ? `${shortNumber(lower)} to ${shortNumber(upper)}` : lower !== null ? `from ${shortNumber(lower)}` : upper !== null ? `up to ${shortNumber(upper)}` : 'none on record';
  const texts = [unitText(unit), `limits ${limits}${parameter.limits_changed ? ' (the newest: they changed)' : ''}`, `right ${shortNumber(low, 3)} to ${shortNumber(high, 3)}`];
  const heading = element('div', { className: 'row-of heading' }, ...['station', 'brakes', 'Cpk (95 %)', periodWords(line.days)].map((textContent) => element('span', { textContent })));
  const rows = parameter.stations.map((station) => parameterRow(parameter, station, findings.find((finding) => finding.station === station.station)));
  const card = element('div', { className: 'card parameter-card' },
                       element('h2', { textContent: `${parameterWords(name)} ${name}` }), element('p', { className: 'quiet', textContent: texts.join('; ') }),
                       element('div', { className: 'stations-in' }, heading, ...rows));
  card.dataset.name = name;
  return card;
}

/** Marked by what is sure of it: `bad` below 1, and `low` below 4/3. */
function cpkCell({ value, lower, upper }) {
  const kind = upper !== null && upper < 1 ? 'cpk bad' : value !== null && value < 4 / 3 ? 'cpk low' : 'cpk';
  const interval = value === null ? '' : `${lower.toFixed(2)} … ${upper.toFixed(2)}`;
  return element('span', { className: kind }, element('b', { textContent: value === null ? '–' : value.toFixed(2) }), element('span', { className: 'quiet', textContent: interval }));
}

function parameterRow(parameter, station, found) {
  const spread = `${shortNumber(station.mean)} ± ${shortNumber(station.sd, 2)} ${unitText(parameter.unit)} over ${cardinal(station.brakes, 'brake')}`;
  const limited = parameter.lower !== null && parameter.upper !== null;
  const strip = limited ? drawing('strip') : element('span', { className: 'nothing', textContent: `${shortNumber(station.mean)} ± ${shortNumber(station.sd, 2)}` });
  const row = element('div', { className: found ? 'row-of found' : 'row-of', title: `${station.station}: ${spread}${found ? `. ${findingText(found.words)}` : ''}` },
                      element('span', { className: 'name', textContent: station.station }), strip, cpkCell(station.cpk), drawing('drift'));
  row.dataset.station = station.station;
  return row;
}

function drawParameters() {
  for (const card of document.querySelectorAll('.parameter-card')) {
    const parameter = line.parameters.find((one) => one.name === card.dataset.name);
    const y = driftRange(parameter);
    for (const row of card.querySelectorAll('[data-station]')) {
      const station = parameter.stations.find((one) => one.station === row.dataset.station);
      const strip = row.querySelector('.strip');
      if (strip) limitBar(strip, { value: station.mean, sd: station.sd, lower: parameter.lower, upper: parameter.upper });
      drawDrift(row.querySelector('.drift'), station.periods, parameter.mean, y);
    }
  }
}

function drawDrift(svg, { mean, sd }, centre, y) {
  svg.replaceChildren();
  const width = svg.clientWidth || 300;
  const height = svg.clientHeight || 40;
  const px = (period) => (((period + 0.5) / mean.length) * width).toFixed(1);
  const py = (value) => Math.max(1, Math.min(height - 1, height - ((value - y[0]) / (y[1] - y[0])) * height)).toFixed(1);
  shape(svg, 'rect', { class: 'ground', x: 0, y: 0, width, height, rx: 4 });
  shadeUnread(svg, line.measured_since, width, height);
  if (centre !== null) shape(svg, 'line', { class: 'centre', x1: 0, x2: width, y1: py(centre), y2: py(centre) });
  const there = mean.flatMap((value, period) => (value === null ? [] : [period]));
  const path = (kind, part) => shape(svg, 'path', { class: kind, d: there.map(part).join('') });
  path('whiskers', (i) => (sd[i] === null ? '' : `M${px(i)} ${py(mean[i] - 2 * sd[i])}V${py(mean[i] + 2 * sd[i])}`));
  path('trace', (i, at) => `${at === 0 ? 'M' : 'L'}${px(i)} ${py(mean[i])}`);
  path('points', (i) => `M${px(i)} ${py(mean[i])}h0`);
}

function showWork() {
  $('work').hidden = line.jobs.length === 0 && line.claims.length === 0;
  $('jobs').replaceChildren(...line.jobs.map(jobRow));
  if (line.claims.length === 0) return $('claims').replaceChildren(element('p', { className: 'quiet', textContent: 'No worker holds a task.' }));
  $('claims').replaceChildren(...line.claims.map((claim) => {
    const since = `${ageText(claim.age_s)}${claim.attempts > 1 ? `, attempt ${claim.attempts}` : ''}`;
    const row = element('div', { className: 'claim' }, element('b', { textContent: claim.worker }), element('span', { textContent: `check of ${claim.serial || claim.check}, job ${claim.job}` }),
                        element('span', { className: 'quiet', textContent: since }));
    if (!claim.alive) row.append(element('span', { className: 'gone', textContent: 'its lease has ended: another worker takes the task over' }));
    return row;
  }));
}

function jobRow(job) {
  const bar = element('div', { className: 'bar' });
  for (const state of ['done', 'failed', 'claimed']) {
    const part = element('i', { className: state, title: `${job[state]} ${state}` });
    part.style.flex = `0 0 ${(100 * job[state]) / Math.max(1, job.tasks)}%`;
    bar.append(part);
  }
  const open = job.waiting + job.claimed;
  const states = [`${job.done} of ${job.tasks} done`, job.claimed > 0 && `${job.claimed} under way`, job.waiting > 0 && `${job.waiting} waiting`, job.failed > 0 && `${job.failed} failed`,
                  job.cancelled > 0 && `${job.cancelled} cancelled`].filter(Boolean).join(', ');
  const when = open === 0 ? '' : job.left_s === null ? 'none has ended in the last ten minutes' : `done in ${ageText(job.left_s)}, ${cardinal(job.workers, 'worker')}`;
  return element('div', { className: 'job' }, element('span', {}, element('b', { textContent: `job ${job.job}${job.name ? ` (${job.name})` : ''}` }), ` ${states}`),
                 element('span', { className: 'quiet', textContent: when, title: `submitted ${utcText(job.submitted)} by ${job.submitted_by}` }), bar,
                 ...job.failures.map((failure) => element('span', { className: 'why', textContent: `${failure.tasks} failed: ${failure.reason}` })));
}

$('spans').append(...kSpans.map(([days, textContent]) => {
  const button = element('button', { type: 'button', value: days, textContent });
  button.addEventListener('click', () => want('days', days));
  return button;
}));
$('part').addEventListener('change', () => {
  $('part').blur();
  want('part_number', $('part').value);
});
addEventListener('resize', () => {
  if (!line) return;
  drawStations();
  drawParameters();
});
showChoices();
refresh();
setInterval(() => {
  if (answered === asked) refresh();
}, kEach_ms);
