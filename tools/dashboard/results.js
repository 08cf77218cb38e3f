// A check's parameters and runs, as the station's view and the history show them.

import { limitBar, lineChart, rangeOf, shortNumber } from '/charts.js';
import { $, element, fixed, unitText } from '/page.js';
import { parameterWords } from '/words.js';

/** "35.12 ± 0.21 N/rad²": the value with two standard deviations, both to the digits that they leave. */
function valueText({ value, sd, unit }) {
  if (value === null || value === undefined) return '';
  const band = 2 * (sd ?? 0);
  if (!(band > 0)) return `${shortNumber(value)} ${unitText(unit)}`;
  const size = Math.max(Math.abs(value), band);
  const power = size < 1e-3 || size >= 1e6 ? Math.floor(Math.log10(size)) : 0;
  const decimals = Math.min(9, Math.max(0, 1 - Math.floor(Math.log10(band)) + power));
  const [middle, spread] = [value, band].map((each) => fixed(each / 10 ** power, decimals));
  return power === 0 ? `${middle} ± ${spread} ${unitText(unit)}` : `(${middle} ± ${spread})e${power} ${unitText(unit)}`;
}

export function showParameters(box, parameters) {
  box.replaceChildren(...parameters.map((parameter) => {
    const bar = document.createElementNS('http://www.w3.org/2000/svg', 'svg');
    bar.setAttribute('class', parameter.verdict);
    return element('div', { className: 'parameter' },
                   element('span', { className: 'name' }, element('small', { textContent: parameterWords(parameter.name) }), ' ', element('b', { textContent: parameter.name })),
                   bar, element('span', { className: 'value', textContent: valueText(parameter) }),
                   element('span', { className: `word ${parameter.verdict}`, textContent: parameter.verdict === 'fail' ? 'FAIL' : parameter.verdict }));
  }));
  box.querySelectorAll('svg').forEach((bar, i) => {
    if (parameters[i].upper > parameters[i].lower) limitBar(bar, parameters[i]);
  });
}

/** "… 0.14 s", "0.1 … 0.2 s": the limits that there are. */
function limitsText({ lower, upper, unit }) {
  if (lower === null && upper === null) return 'no limits';
  return `${lower === null ? '' : `${shortNumber(lower)} `}…${upper === null ? '' : ` ${shortNumber(upper)}`} ${unitText(unit)}`;
}

/** What the requirement sheet asks for; hidden where the station has none. */
export function showSheet(box, sheet) {
  const lines = sheet?.characteristics ?? [];
  box.hidden = lines.length === 0;
  box.replaceChildren(
    element('h2', { textContent: 'Sheet ' }, element('span', { className: 'quiet', textContent: 'value ± 2 sd, limits' })),
    ...(lines.some((line) => line.misfit_marked) ? [element('p', { className: 'quiet', textContent: 'The model does not explain all of this brake’s motion: the deviations count it.' })] : []),
    ...lines.map((line) => {
      const unknown = line.verdict === 'fail' ? 'not reached' : `not known: ${line.why}`;
      return element('div', { className: 'characteristic' },
                     element('span', { textContent: line.name }),
                     element('b', { textContent: line.value === null ? unknown : valueText(line) }),
                     element('small', { textContent: limitsText(line) }),
                     element('span', { className: `word ${line.verdict ?? ''}`, textContent: line.verdict === 'fail' ? 'FAIL' : line.verdict ?? '' }));
    }));
}

export const kChannels = [
  { key: 'force_N', svg: 'force', title: 'clamp force, kN', scale: 1e-3 },
  { key: 'velocity_rad_s', svg: 'velocity', title: 'motor speed, rad/s', scale: 1 },
  { key: 'torque_Nm', svg: 'torque', title: 'motor torque, N m', scale: 1 },
];

/** Three charts, named PREFIX-force and so on, of a run against what it was to follow. */
export function drawRun(prefix, run, references) {
  const reference = run.trajectory > 0 ? references.further[run.trajectory - 1] ?? references : references;
  const ms = (list) => list.map((_, row) => row * reference.period_s * 1e3);
  kChannels.forEach((channel, i) => {
    const scaled = (list) => list.map((value) => value * channel.scale);
    const measured = scaled(run[channel.key]);
    const wanted = scaled(reference[channel.key]);
    const last = i === kChannels.length - 1;
    lineChart($(`${prefix}-${channel.svg}`), {
      x: [0, reference.force_N.length * reference.period_s * 1e3],
      y: rangeOf([measured, wanted]),
      title: channel.title, bottom: last, xTitle: last ? 'ms' : '',
      series: [{ x: ms(wanted), y: wanted, kind: 'reference' }, { x: ms(measured), y: measured, kind: 'measured' }],
    });
  });
}
