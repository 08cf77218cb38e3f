// What the records say about the line: capability, control charts, distribution.

import { ask, kArchivePatience_ms } from '/api.js';
import { controlChart, distribution, shortNumber } from '/charts.js';
import { $, element, setText, unitText, utcText } from '/page.js';
import { parameterWords } from '/words.js';

let statistics = null;
let charted = null;

export async function showStatistics() {
  const wanted = { limit: 1000, part_number: $('statistics-part').value.trim(), batch: $('statistics-batch').value.trim(), since: $('statistics-since').value };
  const query = new URLSearchParams(Object.entries(wanted).filter(([, value]) => value !== ''));
  try {
    statistics = await ask(`/v1/statistics?${query}`, { within_ms: kArchivePatience_ms });
  } catch (error) {
    statistics = null;
    setText($('statistics-text'), '');
    return showNothing(error.message);
  }
  showParts(statistics);
}

/** Brakes of several part numbers are never in one chart: one of them is chosen. */
function showParts(found) {
  statistics = found;
  setText($('statistics-text'), headline());
  if (found.parts?.length > 0) {
    showNothing('These are brakes of several part numbers, which no chart mixes. Choose one:');
    $('capability').append(...found.parts.map((part) => {
      const button = element('button', { type: 'button', textContent: `${part.part_number || 'no part number'}: ${part.checks} checks` });
      button.addEventListener('click', () => showParts(part));
      return button;
    }));
    return;
  }
  if (statistics.parameters.length === 0) return showNothing('Capability and charts need at least two brakes with a valid check.');
  showTable();
  drawStatistics();
}

function showNothing(why) {
  $('capability').replaceChildren(element('p', { className: 'quiet', textContent: why }));
  for (const id of ['chart-individuals', 'chart-range', 'chart-distribution', 'signals']) $(id).replaceChildren();
  setText($('chart-name'), '');
}

function headline() {
  const { checks, passed, failed, invalid, first, last, simulated } = statistics;
  if (checks === 0) return 'no checks';
  const share = passed + failed > 0 ? `; yield ${(100 * passed / (passed + failed)).toFixed(1)} %` : '';
  const kind = statistics.simulated_left_out ? `; ${simulated} of simulated brakes left out` : simulated > 0 ? `; ${simulated} of them on SIMULATED brakes` : '';
  const left = statistics.other_limits > 0 ? `; ${statistics.other_limits} brakes that a recipe judged by other limits left out` : '';
  const part = statistics.part_number ? `part number ${statistics.part_number}: ` : '';
  return `${part}${checks} checks, ${utcText(first)} to ${utcText(last)}: ${passed} passed, ${failed} failed, ${invalid} invalid${share}${kind}${left}`;
}

const kHeadings = ['parameter', 'brakes', 'mean', 'sd', 'Cp', 'Cpk', 'Ppk', 'signals'];

function showTable() {
  const body = element('tbody');
  for (const parameter of statistics.parameters) {
    const signals = parameter.individuals.signals.length + parameter.moving_range.signals.length;
    const cells = [`${parameterWords(parameter.name)} ${parameter.name}, ${unitText(parameter.unit)}`, parameter.n, shortNumber(parameter.mean), shortNumber(parameter.sd_overall, 3),
                   shortNumber(parameter.cp.value, 3), shortNumber(parameter.cpk.value, 3), shortNumber(parameter.ppk.value, 3), signals || ''];
    const row = element('tr', { tabIndex: 0 }, ...cells.map((text) => element('td', { textContent: text })));
    row.dataset.name = parameter.name;
    for (const event of ['click', 'focus']) row.addEventListener(event, () => choose(parameter.name));
    body.append(row);
  }
  const head = element('thead', {}, element('tr', {}, ...kHeadings.map((text) => element('th', { textContent: text }))));
  $('capability').replaceChildren(element('div', { className: 'wide-table' }, element('table', {}, head, body)),
                                  element('p', { className: 'quiet', textContent: 'The last valid check of each brake counts. Choose a parameter: Tab or click.' }));
}

function choose(name) {
  charted = name;
  drawStatistics();
}

/** The charts of the chosen parameter, or of the first one. */
export function drawStatistics() {
  if (!statistics || statistics.parameters.length === 0) return;
  const parameter = statistics.parameters.find((each) => each.name === charted) ?? statistics.parameters[0];
  for (const row of $('capability').querySelectorAll('tbody tr')) row.setAttribute('aria-selected', row.dataset.name === parameter.name);
  const { name, lower, upper, individuals, moving_range: range } = parameter;
  setText($('chart-name'), `${parameterWords(name)} ${name}${parameter.unit ? `, ${unitText(parameter.unit)}` : ''}; specification ${shortNumber(lower)} to ${shortNumber(upper)}`);
  controlChart($('chart-individuals'), { ...individuals, specification: [lower, upper] }, 'brake');
  controlChart($('chart-range'), range, 'brake');
  distribution($('chart-distribution'), individuals.points, [lower, upper]);
  const signals = [...individuals.signals.map((signal) => `${statistics.serials[signal.at] ?? ''}: ${signal.description} (${signal.rule})`),
                   ...range.signals.map((signal) => `${statistics.serials[signal.at + 1] ?? ''}: moving range beyond its limit`)];
  $('signals').replaceChildren(...(signals.length > 0 ? signals : ['Nothing that chance does not explain.']).map((text) => element('p', { textContent: text })));
}

for (const id of ['statistics-part', 'statistics-batch', 'statistics-since']) $(id).addEventListener('change', () => showStatistics());
$('statistics-filter').addEventListener('submit', (event) => {
  event.preventDefault();
  showStatistics();
});
