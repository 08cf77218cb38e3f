// The checks on record: list, filters, export, and one of them whole.

import { ask, kArchivePatience_ms } from '/api.js';
import { shortNumber } from '/charts.js';
import { $, element, localText, setText, utcText } from '/page.js';
import { drawRun, kChannels, showParameters, showSheet } from '/results.js';
import { causeText, reasonText } from '/words.js';

const kMostListed = 1000;

let checks = [];
let chosen = null;
let reference = null;

const badge = (verdict, marginal) => element('span', { className: `badge ${verdict}`, textContent: verdict + (marginal ? ' !' : ''), title: marginal ? 'marginal' : '' });
const timeElement = (time) => element('time', { textContent: utcText(time), dateTime: time, title: localText(time) });

/** What the station is asked for; the serial number only if it is given whole. */
function query(serial = '') {
  const wanted = { limit: kMostListed, verdict: $('filter-verdict').value, part_number: $('filter-part').value.trim(), since: $('filter-since').value, until: $('filter-until').value, serial };
  return new URLSearchParams(Object.entries(wanted).filter(([, value]) => value !== '')).toString();
}

export async function listHistory(currentReference, serial = '') {
  reference = currentReference ?? reference;
  try {
    checks = (await ask(`/v1/results?${query(serial)}`, { within_ms: kArchivePatience_ms })).checks;
  } catch (error) {
    checks = [];
    showList();
    return $('history-list').replaceChildren(element('p', { textContent: error.message }));
  }
  showList();
}

function showList() {
  const wanted = $('filter-serial').value.trim().toLowerCase();
  const shown = checks.filter((check) => check.serial.toLowerCase().includes(wanted));
  const cut = checks.length === kMostListed ? ` among the newest ${kMostListed}; Enter asks for exactly this serial number` : '';
  setText($('history-count'), `${shown.length} checks${cut}`);
  $('history-list').replaceChildren(...shown.map((check) => {
    const row = element('button', { type: 'button', title: check.reason }, badge(check.verdict, check.marginal), timeElement(check.started),
                        element('span', { className: check.void ? 'serial void' : 'serial', textContent: check.void ? `${check.serial} (void)` : check.serial }));
    row.dataset.record = check.record;
    row.setAttribute('aria-selected', check.record === chosen);
    row.addEventListener('click', () => choose(check.record));
    return row;
  }));
  offerExports(shown);
  const first = $('history-list').querySelector('[aria-selected="true"]') ?? $('history-list').querySelector('button');
  if (!$('filter').contains(document.activeElement)) first?.focus();
}

// ---------------------------------------------------------------------------------------------- export

const kColumns = ['record', 'serial', 'started', 'verdict', 'marginal', 'simulated', 'repeats', 'duration_s', 'reason'];

/** A cell that no spreadsheet takes for a formula, nor its contents for another cell. */
function cell(value) {
  const text = String(value ?? '');
  return `"${(/^[=+\-@\t\r]/.test(text) ? `'${text}` : text).replaceAll('"', '""')}"`;
}

function offerExports(shown) {
  const rows = shown.map((check) => kColumns.map((name) => cell(check[name])).join(','));
  const files = { csv: ['text/csv', [kColumns.join(','), ...rows, ''].join('\r\n')], json: ['application/json', JSON.stringify({ schema: 'clampd.checks/1', checks: shown }, null, 2)] };
  for (const [ending, [type, text]] of Object.entries(files)) {
    $(`export-${ending}`).href = `data:${type};charset=utf-8,${encodeURIComponent(text)}`;
    $(`export-${ending}`).download = `checks.${ending}`;
  }
}

// ---------------------------------------------------------------------------------------------- filters

$('filter-serial').addEventListener('input', showList);
for (const id of ['filter-verdict', 'filter-part', 'filter-since', 'filter-until']) $(id).addEventListener('change', () => listHistory());
$('filter').addEventListener('submit', (event) => {
  event.preventDefault();
  listHistory(null, checks.length === kMostListed ? $('filter-serial').value.trim() : '');
});
$('view-history').addEventListener('keydown', (event) => {
  const step = { ArrowDown: 1, ArrowUp: -1 }[event.key];
  if (!step || $('filter').contains(event.target)) return;
  event.preventDefault();
  const rows = [...$('history-list').querySelectorAll('button')];
  const next = rows[Math.min(rows.length - 1, Math.max(0, rows.indexOf(document.activeElement) + step))];
  next?.focus();
  next?.click();
});

// ---------------------------------------------------------------------------------------------- one check

function factsOf(check) {
  return {
    started: utcText(check.started), bench: `${shortNumber(check.duration_s, 3)} s, ${check.repeats} repeats${check.stopping ? `: ${check.stopping.reason}` : ''}`, operator: check.operator, 'part number': check.part_number, recipe: check.recipe ? `version ${check.recipe.version}, SHA-256 ${check.recipe.sha256}` : '',
    batch: check.batch, station: check.station, fixture: check.fixture, limits: [check.limits.file, check.limits.revision].filter(Boolean).join(' '),
    tracking: `${shortNumber(check.tracking_rms_N, 3)} N rms`, timing: `${check.timing.skipped} skipped, ${shortNumber(check.timing.lateness_us.max, 3)} µs late at most`,
    software: check.software_version, record: check.record,
  };
}

function runCharts() {
  return kChannels.map((channel, i) => {
    const svg = document.createElementNS('http://www.w3.org/2000/svg', 'svg');
    svg.id = `past-${channel.svg}`;
    svg.setAttribute('class', i === kChannels.length - 1 ? 'chart axis' : 'chart');
    return svg;
  });
}

async function choose(id) {
  chosen = id;
  for (const row of $('history-list').querySelectorAll('button')) row.setAttribute('aria-selected', row.dataset.record === id);
  const detail = $('history-detail');
  const address = `/v1/results/${encodeURIComponent(id)}`;
  let check;
  try {
    check = await ask(address, { within_ms: kArchivePatience_ms });
  } catch (error) {
    return detail.replaceChildren(element('p', { textContent: error.message }));
  }
  if (chosen !== id) return;  // another one was chosen meanwhile
  const list = element('dl');
  for (const [name, value] of Object.entries(factsOf(check))) if (value) list.append(element('dt', { textContent: name }), element('dd', { textContent: value }));
  const parameters = element('div', { className: 'parameters' });
  const sheet = element('div', { className: 'sheet' });
  const runs = element('select', { ariaLabel: 'run' }, ...check.runs.map((_, i) => element('option', { value: i, textContent: `run ${i + 1}` })));
  const charts = runCharts();
  detail.replaceChildren(
    element('h2', {}, badge(check.verdict, check.marginal), element('span', { textContent: check.serial }), ...(check.simulated ? [element('span', { className: 'pill warn', textContent: 'SIMULATED' })] : []),
            element('a', { href: address, download: `${check.record}.json`, textContent: 'JSON' })),
    element('p', { textContent: reasonText(check.reason) }),
    ...(check.void ? [element('p', { textContent: `VOID, by ${check.void.by}, ${utcText(check.void.when)}: ${check.void.reason}` })] : []),
    ...(check.cause ? [element('p', {}, element('b', { textContent: causeText(check.cause) }))] : []),
    parameters, sheet, list, element('p', { className: 'quiet', textContent: `The whole report: clampctl report ${check.record}` }), ...(check.runs.length > 0 ? [runs, ...charts] : []));
  showParameters(parameters, check.parameters);
  showSheet(sheet, check.sheet);
  const drawPast = async () => {
    try {
      drawRun('past', await ask(`${address}/runs/${runs.value}`, { within_ms: kArchivePatience_ms }), reference);
    } catch {
      charts.forEach((svg) => svg.replaceChildren());
    }
  };
  runs.addEventListener('change', drawPast);
  if (check.runs.length > 0 && reference) await drawPast();
}
