// The station's screen. Talks to the control API of the daemon that served it (tools/control/messages.hpp) and to
// nobody else. Texts reach the page as text nodes only: a serial number is never markup.

import { controlChart, histogram, limitBar, lineChart, rangeOf, shortNumber } from '/charts.js';

const $ = (id) => document.getElementById(id);

function element(tag, properties = {}, ...children) {
  const node = document.createElement(tag);
  Object.assign(node, properties);
  node.append(...children);
  return node;
}

/** Without the minus that a rounded zero would keep. */
const fixed = (value, digits) => (Number(value.toFixed(digits)) + 0).toFixed(digits);

const unitText = (unit) => unit.replaceAll('^2', '²').replaceAll('^3', '³');

const setText = (node, text) => {
  if (node.textContent !== text) node.textContent = text;
};

// ---------------------------------------------------------------------------------------------- the daemon

const kTokenKey = 'clampd.token';
const fromAddress = new URLSearchParams(location.hash.slice(1)).get('token');
if (fromAddress) {
  sessionStorage.setItem(kTokenKey, fromAddress);
  history.replaceState(null, '', location.pathname);  // nobody shall read it off the address line
}

/** The answer's document. Throws an Error with the station's words, `status` 0 where no daemon answered. */
async function ask(path, body) {
  const headers = {};
  const token = sessionStorage.getItem(kTokenKey);
  if (token) headers.Authorization = `Bearer ${token}`;
  if (body !== undefined) headers['Content-Type'] = 'application/json';
  let response;
  let answer;
  try {
    response = await fetch(path, { method: body === undefined ? 'GET' : 'POST', headers, body: body && JSON.stringify(body) });
    answer = await response.json();
  } catch {
    throw Object.assign(new Error('no answer from the station’s daemon'), { status: 0 });
  }
  if (!response.ok) throw Object.assign(new Error(answer.error ?? `status ${response.status}`), { status: response.status });
  return answer;
}

async function checkSession() {
  const session = await ask('/v1/session');
  $('unlock').hidden = session.may_command;
  $('entry').hidden = !session.may_command;
  if (session.may_command && !view('history') && !view('statistics')) $('serial').focus();
}

// ---------------------------------------------------------------------------------------------- the station

let status = null;   // the last status; null: the daemon does not answer
let record = null;   // the last check's clampd.check/1
let starting = false;
let expected = 0;    // number of the check that was started here

/** A check is under way, or about to be: one that has begun without a verdict moves, even before its first state. */
function moving() {
  if (starting || status === null) return starting;
  return expected > status.check || ['ARMED', 'RUNNING', 'RELEASING'].includes(status.state) ||
         (status.state === 'IDLE' && status.check > 0 && status.last_verdict === '' && !status.judging);
}

const kParameterNames = ['k1', 'k2', 'TC', 'Ts0', 'Tv', 'mus', 'ws'];
const kStatePills = { IDLE: 'good', FAULT: 'bad', ARMED: 'busy', RUNNING: 'busy', RELEASING: 'busy' };
const kPhases = { tare: 'taring', approach: 'closing', settle: 'settling', trajectory: 'running', return: 'returning', release: 'opening' };

function show(kind, word, serial, reason, cause = '', marginal = false) {
  const box = $('verdict');
  box.dataset.kind = kind;
  box.dataset.length = word.length;
  setText($('verdict-word'), word);
  setText($('verdict-serial'), serial);
  setText($('verdict-reason'), reason);
  setText($('verdict-cause'), cause);
  $('verdict-cause').hidden = !cause;
  $('verdict-marginal').hidden = !marginal;
  document.title = `${word} ${serial} – ${status?.station ?? 'clampd'}`;
}

function causeText(cause) {
  if (!cause) return '';
  if (cause.effect) return `Cause: ${cause.effect}${cause.location ? ` (${cause.location})` : ''}`;
  if (cause.rivals.length > 0) return `Cause: one of ${cause.rivals[0].join(', ')}`;
  return cause.location ? `Cause: unknown, in the ${cause.location}` : '';
}

function showVerdict() {
  const busy = moving() || status.judging;
  $('progress').hidden = !busy;
  if (busy) {
    const repeats = status.repeats;
    $('progress').value = status.judging ? 1 : repeats > 0 ? status.repeat / repeats : 0;
    const run = repeats > 0 ? `run ${Math.min(status.repeat + 1, repeats)} of ${repeats}` : '';
    show('running', status.judging ? 'JUDGING' : 'RUNNING', status.serial,
         status.judging ? 'the brake is done; the verdict is being made' : [run, kPhases[status.phase] ?? ''].filter(Boolean).join(', '));
  } else if (record) {
    show(record.verdict, record.verdict, record.serial, record.reason, causeText(record.cause), record.marginal);
  } else if (status.state === 'FAULT') {
    show('ERROR', 'FAULT', '', 'see below');
  } else if (status.state === 'IDLE') {
    show('none', 'READY', status.next_serial, status.next_serial ? 'press the start button' : 'scan or type a serial number, then Enter');
  } else {
    show('none', status.state, '', 'waiting for the brake');
  }
}

function showInterlocks() {
  const chips = status.panel.map((line) => {
    const bad = line.state === 'lost' || (line.role === 'emergency stop' && line.state !== 'closed');
    const open = line.role === 'fixture closed' && line.state === 'open';
    return element('span', { className: `pill ${bad ? 'bad' : open ? 'warn' : ''}`, title: line.line, textContent: `${line.role}: ${line.state}` });
  });
  $('interlocks').replaceChildren(...chips);
}

function publishingTrouble(channel) {
  if (!channel.error && (channel.connected || channel.pending === 0)) return '';
  const waiting = channel.pending > 0 ? ` ${channel.pending} checks wait to be published; they are safe in the station’s database.` : '';
  return `${channel.channel} (${channel.where}): ${channel.error || 'not connected.'}${waiting}`;
}

function showStatus() {
  setText($('station'), status.station);
  setText($('state'), status.state);
  $('state').className = `pill ${kStatePills[status.state] ?? 'warn'}`;
  $('simulated').hidden = !status.simulated;
  showInterlocks();
  setText($('link'), `${status.interface} ${status.link} · ${fixed(status.force_N / 1000, 1)} kN · ${fixed(status.velocity_rad_s, 0)} rad/s · ${fixed(status.torque_Nm, 2)} N m`);
  $('notices').replaceChildren(...[status.storage, status.clock, status.notice, status.master, ...status.publishing.map(publishingTrouble)].filter(Boolean).map((text) => element('div', { textContent: text })));
  const fault = status.state === 'FAULT';
  $('fault').hidden = !fault;
  if (fault) {
    setText($('fault-name'), status.fault);
    setText($('fault-text'), `${status.fault_text} ${status.clearable ? '' : 'Its cause is still there.'}`);
    $('clear').disabled = !status.clearable;
  }
  $('serial').disabled = fault;
  // Not `disabled`: Enter would then do nothing, without a word.
  $('start').setAttribute('aria-disabled', status.state !== 'IDLE' || moving() || status.judging);
  $('verdict').classList.remove('stale');
  showVerdict();
}

function showOffline() {
  setText($('state'), 'NO DAEMON');
  $('state').className = 'pill bad';
  $('notices').replaceChildren(element('div', { textContent: 'The station’s daemon does not answer: nothing here is up to date. `systemctl status clampd` says why.' }));
  $('verdict').classList.add('stale');
  $('start').setAttribute('aria-disabled', true);
}

// ---------------------------------------------------------------------------------------------- runs

const kChannels = [
  { key: 'force_N', svg: 'force', title: 'clamp force, kN', scale: 1e-3 },
  { key: 'velocity_rad_s', svg: 'velocity', title: 'motor speed, rad/s', scale: 1 },
  { key: 'torque_Nm', svg: 'torque', title: 'motor torque, N m', scale: 1 },
];

let reference = null;
let live = { run: 0, repeat: 0, force_N: [], velocity_rad_s: [], torque_Nm: [] };

/** Three charts, named PREFIX-force and so on, of a run against the reference. */
function drawRun(prefix, run) {
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

async function followRun() {
  const more = await ask(`/v1/live?run=${live.run}&row=${live.force_N.length}`);
  if (more.run === live.run && more.force_N.length === 0) return;
  if (more.run !== live.run || more.from === 0) live = more;
  else for (const { key } of kChannels) live[key].push(...more[key]);
  setText($('run-name'), live.run > 0 ? `${live.repeat + 1}` : '');
  drawRun('live', live);
}

// ---------------------------------------------------------------------------------------------- results

function showParameters(box, parameters) {
  const cells = [];
  for (const parameter of parameters) {
    const bar = document.createElementNS('http://www.w3.org/2000/svg', 'svg');
    bar.setAttribute('class', parameter.verdict);
    const digits = parameter.sd > 0 ? Math.min(6, Math.max(2, Math.ceil(Math.log10(Math.abs(parameter.value) / parameter.sd)) + 1)) : 4;
    const known = parameter.value !== null && parameter.value !== undefined;
    cells.push(element('b', { textContent: parameter.name }), bar,
               element('span', { className: 'value', textContent: known ? `${shortNumber(parameter.value, digits)} ± ${shortNumber(parameter.sd, 2)} ${unitText(parameter.unit)}` : '' }),
               element('span', { className: `word ${parameter.verdict}`, textContent: parameter.verdict === 'fail' ? 'FAIL' : parameter.verdict }));
  }
  box.replaceChildren(...cells);
  box.querySelectorAll('svg').forEach((bar, i) => {
    if (parameters[i].upper > parameters[i].lower) limitBar(bar, parameters[i]);
  });
}

function showRecord() {
  const parameters = record?.parameters ?? [];
  showParameters($('parameters'), parameters.length > 0 ? parameters : kParameterNames.map((name) => ({ name, unit: '', verdict: '' })));
  if (!record) {
    setText($('timing-text'), '');
    return histogram($('timing'), []);
  }
  const { ticks, skipped, lost_samples: lost, lateness_us: late, lateness_histogram_us: bins } = record.timing;
  setText($('timing-text'), `${ticks} ticks, ${skipped} skipped, ${lost} samples lost, late by ${shortNumber(late.avg, 3)} µs on average, ${shortNumber(late.max, 3)} µs at most`);
  histogram($('timing'), bins ?? []);
}

// ---------------------------------------------------------------------------------------------- sound

const kTones = { PASS: [880, 1175], FAIL: [220, 175], ERROR: [330, 330], TIMEOUT: [330, 330], ABORTED: [330, 330] };
let audio = null;

function sound(verdict) {
  if ($('sound').getAttribute('aria-pressed') !== 'true') return;
  audio ??= new AudioContext();
  (kTones[verdict] ?? []).forEach((frequency, i) => {
    const tone = audio.createOscillator();
    tone.frequency.value = frequency;
    tone.connect(audio.destination);
    tone.start(audio.currentTime + 0.25 * i);
    tone.stop(audio.currentTime + 0.25 * i + 0.2);
  });
}

$('sound').addEventListener('click', () => {
  const on = $('sound').getAttribute('aria-pressed') !== 'true';
  $('sound').setAttribute('aria-pressed', on);
  setText($('sound'), on ? 'Sound on' : 'Sound off');
  if (on) sound('PASS');
});

// ---------------------------------------------------------------------------------------------- following

let seen = { check: null, judged: null };

/** The record of the last check, once there is one: of this or, where the daemon has made none yet, of none. */
async function followRecord() {
  const judged = status.last_verdict;  // changes once more where a result was saved late
  if (seen.check === status.check && seen.judged === judged) return;
  const progress = judged !== '' ? await ask('/v1/checks/current') : null;
  const news = seen.check !== null && judged !== '';
  seen = { check: status.check, judged };
  record = progress?.record ?? null;
  showRecord();
  if (news && record) sound(record.verdict);
}

async function follow() {
  const wasOffline = status === null;
  try {
    status = await ask('/v1/status');
    if (wasOffline) {
      reference = await ask('/v1/reference');
      live = { run: 0, repeat: 0, force_N: [], velocity_rad_s: [], torque_Nm: [] };
      seen = { check: null, judged: null };
      await checkSession();
    }
    await followRecord();
    showStatus();
    await followRun();
    if (wasOffline) drawRun('live', live);
  } catch (error) {
    status = null;
    expected = 0;
    showOffline();
    if (error.status !== 0) console.error(error);
  }
  setTimeout(follow, status === null ? 1000 : moving() ? 80 : 250);
}

// ---------------------------------------------------------------------------------------------- commands

function say(text) {
  setText($('message'), text);
}

/** The answer; null, and the station's words on the screen, if it refuses. */
async function command(path, body, done) {
  try {
    const answer = await ask(path, body);
    say(done);
    return answer;
  } catch (error) {
    say(error.message);
    if (error.status === 401) checkSession().catch(() => {});
    return null;
  }
}

$('operator').value = sessionStorage.getItem('clampd.operator') ?? '';
$('operator').addEventListener('change', () => sessionStorage.setItem('clampd.operator', $('operator').value));

$('entry').addEventListener('submit', async (event) => {
  event.preventDefault();
  const serial = $('serial').value.trim();
  if (!serial) {
    $('serial').focus();
    return say('Scan or type the serial number first.');
  }
  if (moving() || status?.judging) return say(`${serial} was not started: a check is under way.`);
  starting = true;
  const started = await command('/v1/checks', { serial, operator_name: $('operator').value.trim() }, '');
  starting = false;
  if (started) {
    expected = started.check;
    $('serial').value = '';
  } else {
    $('serial').select();
  }
  $('serial').focus();
});

const stop = () => command('/v1/stop', {}, 'Stopped.');
const clear = () => command('/v1/clear', {}, 'Cleared.').then(() => $('serial').focus());
$('stop').addEventListener('click', stop);
$('clear').addEventListener('click', clear);

$('unlock').addEventListener('submit', async (event) => {
  event.preventDefault();
  sessionStorage.setItem(kTokenKey, $('token').value.trim());
  $('token').value = '';
  await checkSession().catch(() => {});
});

// ---------------------------------------------------------------------------------------------- keyboard, views

const view = (name) => !$(`view-${name}`).hidden;

function open(name) {
  for (const button of document.querySelectorAll('nav button[data-view]')) {
    const chosen = button.dataset.view === name;
    $(`view-${button.dataset.view}`).hidden = !chosen;
    if (chosen) button.setAttribute('aria-current', 'page');
    else button.removeAttribute('aria-current');
  }
  if (name === 'station') {
    if (reference) drawRun('live', live);
    showRecord();
    $('serial').focus();
  }
  if (name === 'history') listHistory();
  if (name === 'statistics') showStatistics();
}

for (const button of document.querySelectorAll('nav button[data-view]')) button.addEventListener('click', () => open(button.dataset.view));

// A scanner types like a keyboard: a "c" that others follow at once is part of a number, no command.
const kAloneFor_ms = 250;
let waitingClear = null;

document.addEventListener('keydown', (event) => {
  clearTimeout(waitingClear);
  if (event.key === 'Escape' && !event.repeat) {
    event.preventDefault();
    if (moving() || status === null) stop();
    return;
  }
  const views = { F2: 'station', F3: 'history', F4: 'statistics' };
  if (views[event.key]) {
    event.preventDefault();
    return open(views[event.key]);
  }
  if (event.repeat || event.ctrlKey || event.altKey || event.metaKey) return;
  const typing = event.target instanceof HTMLInputElement && !event.target.disabled;
  if (!typing && status?.state === 'FAULT' && event.key === 'c') waitingClear = setTimeout(clear, kAloneFor_ms);
  else if (!typing && view('station') && event.key.length === 1 && !$('serial').disabled && !$('entry').hidden) $('serial').focus();
});

// ---------------------------------------------------------------------------------------------- history

let checks = [];
let chosen = null;

const when = (started) => new Date(started).toLocaleString('sv-SE');
const badge = (verdict, marginal) => element('span', { className: `badge ${verdict}`, textContent: verdict + (marginal ? ' !' : ''), title: marginal ? 'marginal' : '' });

async function listHistory() {
  try {
    checks = (await ask(`/v1/results?limit=500&verdict=${encodeURIComponent($('filter-verdict').value)}`)).checks;
  } catch (error) {
    checks = [];
    return $('history-list').replaceChildren(element('p', { textContent: error.message }));
  }
  filterHistory();
}

function filterHistory() {
  const wanted = $('filter-serial').value.trim().toLowerCase();
  const shown = checks.filter((check) => check.serial.toLowerCase().includes(wanted));
  setText($('history-count'), `${shown.length} checks`);
  $('history-list').replaceChildren(...shown.map((check) => {
    const row = element('button', { type: 'button', title: check.reason }, badge(check.verdict, check.marginal),
                        element('time', { textContent: when(check.started), dateTime: check.started }),
                        element('span', { className: 'serial', textContent: check.serial }));
    row.dataset.record = check.record;
    row.setAttribute('aria-selected', check.record === chosen);
    row.addEventListener('click', () => choose(check.record));
    return row;
  }));
  const first = $('history-list').querySelector('[aria-selected="true"]') ?? $('history-list').querySelector('button');
  if (document.activeElement !== $('filter-serial') && document.activeElement !== $('filter-verdict')) first?.focus();
}

$('filter-serial').addEventListener('input', filterHistory);
$('filter-verdict').addEventListener('change', listHistory);
$('filter').addEventListener('submit', (event) => event.preventDefault());
$('view-history').addEventListener('keydown', (event) => {
  const step = { ArrowDown: 1, ArrowUp: -1 }[event.key];
  if (!step || event.target === $('filter-verdict')) return;
  event.preventDefault();
  const rows = [...$('history-list').querySelectorAll('button')];
  const next = rows[Math.min(rows.length - 1, Math.max(0, rows.indexOf(document.activeElement) + step))];
  next?.focus();
  next?.click();
});

async function choose(id) {
  chosen = id;
  for (const row of $('history-list').querySelectorAll('button')) row.setAttribute('aria-selected', row.dataset.record === id);
  const detail = $('history-detail');
  let check;
  try {
    check = await ask(`/v1/results/${encodeURIComponent(id)}`);
  } catch (error) {
    return detail.replaceChildren(element('p', { textContent: error.message }));
  }
  if (chosen !== id) return;  // another one was chosen meanwhile
  const facts = { started: when(check.started), bench: `${shortNumber(check.duration_s, 3)} s, ${check.repeats} repeats`, operator: check.operator, 'part number': check.part_number,
                  batch: check.batch, station: check.station, fixture: check.fixture, limits: [check.limits.file, check.limits.revision].filter(Boolean).join(' '),
                  tracking: `${shortNumber(check.tracking_rms_N, 3)} N rms`, timing: `${check.timing.skipped} skipped, ${shortNumber(check.timing.lateness_us.max, 3)} µs late at most`,
                  software: check.software_version, record: check.record };
  const list = element('dl');
  for (const [name, value] of Object.entries(facts)) if (value) list.append(element('dt', { textContent: name }), element('dd', { textContent: value }));
  const parameters = element('div', { className: 'parameters' });
  const runs = element('select', { ariaLabel: 'run' }, ...check.runs.map((_, i) => element('option', { value: i, textContent: `run ${i + 1}` })));
  const charts = kChannels.map((channel, i) => {
    const svg = document.createElementNS('http://www.w3.org/2000/svg', 'svg');
    svg.id = `past-${channel.svg}`;
    svg.setAttribute('class', i === kChannels.length - 1 ? 'chart axis' : 'chart');
    return svg;
  });
  detail.replaceChildren(
    element('h2', {}, badge(check.verdict, check.marginal), element('span', { textContent: check.serial }), ...(check.simulated ? [element('span', { className: 'pill warn', textContent: 'SIMULATED' })] : [])),
    element('p', { textContent: check.reason }),
    ...(check.cause ? [element('p', {}, element('b', { textContent: causeText(check.cause) }), ` ${check.cause.summary}`)] : []),
    parameters, list, ...(check.runs.length > 0 ? [runs, ...charts] : []));
  showParameters(parameters, check.parameters);
  const drawPast = async () => {
    try {
      drawRun('past', await ask(`/v1/results/${encodeURIComponent(check.record)}/runs/${runs.value}`));
    } catch (error) {
      charts.forEach((svg) => svg.replaceChildren());
    }
  };
  runs.addEventListener('change', drawPast);
  if (check.runs.length > 0 && reference) await drawPast();
}

// ---------------------------------------------------------------------------------------------- statistics

let statistics = null;
let charted = null;

async function showStatistics() {
  try {
    statistics = await ask('/v1/statistics?limit=500');
  } catch (error) {
    return $('capability').replaceChildren(element('p', { textContent: error.message }));
  }
  const judged = statistics.passed + statistics.failed;
  setText($('statistics-text'), `${statistics.checks} checks: ${statistics.passed} passed, ${statistics.failed} failed, ${statistics.invalid} invalid` +
          (judged > 0 ? `; yield ${(100 * statistics.passed / judged).toFixed(1)} %` : '') + (statistics.simulated > 0 ? `; ${statistics.simulated} simulated` : ''));
  if (statistics.parameters.length === 0) {
    return $('capability').replaceChildren(element('p', { className: 'quiet', textContent: 'Capability and charts need at least two brakes with a valid check.' }));
  }
  const body = element('tbody');
  for (const parameter of statistics.parameters) {
    const signals = parameter.individuals.signals.length + parameter.moving_range.signals.length;
    const row = element('tr', { tabIndex: 0 }, ...[`${parameter.name}, ${unitText(parameter.unit)}`, parameter.n, shortNumber(parameter.mean), shortNumber(parameter.sd_overall, 3), shortNumber(parameter.cp.value, 3),
                        shortNumber(parameter.cpk.value, 3), shortNumber(parameter.ppk.value, 3), signals || ''].map((text) => element('td', { textContent: text })));
    row.dataset.name = parameter.name;
    row.addEventListener('click', () => chart(parameter.name));
    row.addEventListener('focus', () => chart(parameter.name));
    body.append(row);
  }
  $('capability').replaceChildren(element('table', {}, element('thead', {}, element('tr', {}, ...['parameter', 'brakes', 'mean', 'sd', 'Cp', 'Cpk', 'Ppk', 'signals'].map((text) => element('th', { textContent: text })))), body),
                                  element('p', { className: 'quiet', textContent: 'The last valid check of each brake counts. Choose a parameter: Tab or click.' }));
  chart(statistics.parameters.some((parameter) => parameter.name === charted) ? charted : statistics.parameters[0].name);
}

function chart(name) {
  charted = name;
  const parameter = statistics.parameters.find((each) => each.name === name);
  for (const row of $('capability').querySelectorAll('tbody tr')) row.setAttribute('aria-selected', row.dataset.name === name);
  setText($('chart-name'), `${name}${parameter.unit ? `, ${unitText(parameter.unit)}` : ''}; red dashes: control limits; specification ${shortNumber(parameter.lower)} to ${shortNumber(parameter.upper)}`);
  controlChart($('chart-individuals'), parameter.individuals, 'brake');
  controlChart($('chart-range'), parameter.moving_range, 'brake');
  const signals = [...parameter.individuals.signals.map((signal) => `${statistics.serials[signal.at] ?? ''}: ${signal.description} (${signal.rule})`),
                   ...parameter.moving_range.signals.map((signal) => `${statistics.serials[signal.at + 1] ?? ''}: moving range beyond its limit`)];
  $('signals').replaceChildren(...(signals.length > 0 ? signals : ['Nothing that chance does not explain.']).map((text) => element('p', { textContent: text })));
}

window.addEventListener('resize', () => {
  if (view('station') && reference) {
    drawRun('live', live);
    showRecord();
  }
  if (view('statistics') && statistics?.parameters.length > 0) chart(charted);
});

showRecord();
follow();
