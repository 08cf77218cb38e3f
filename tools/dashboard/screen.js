// The station's screen: what the station does, and what the operator may ask of it. History and statistics are beside.

import { ask, keepToken, kPatience_ms } from '/api.js';
import { histogram, shortNumber } from '/charts.js';
import { listHistory } from '/history.js';
import { $, element, fixed, setText } from '/page.js';
import { drawRun, kChannels, showParameters, showSheet } from '/results.js';
import { drawStatistics, showStatistics } from '/statistics.js';
import { actionText, causeText, kParameterNames, reasonText } from '/words.js';

async function checkSession() {
  const session = await ask('/v1/session');
  $('unlock').hidden = session.may_command;
  $('entry').hidden = !session.may_command;
  if (session.may_command && view('station')) $('serial').focus();
}

// ---------------------------------------------------------------------------------------------- the station

let status = null;    // the last status; null: the station does not answer
let record = null;    // the last check's clampd.check/1
let reference = null;
let pending = null;   // the check asked for, until a status that was asked for after it was granted
let judgingSince = 0;

/** The drive is on, or is about to be. */
function moving() {
  if (pending !== null || status === null) return pending !== null;
  return status.opening || !['INIT', 'IDLE', 'FAULT'].includes(status.state) || (status.state === 'IDLE' && isBegun());
}
/** A check has begun that has no verdict yet, even before its first state. */
const isBegun = () => status.check > 0 && status.last_verdict === '' && !status.judging;
const busy = () => moving() || (status?.judging ?? false);

const kStatePills = { IDLE: 'good', FAULT: 'bad', ARMED: 'busy', RUNNING: 'busy', RELEASING: 'busy' };
const kPhases = { tare: 'taring', approach: 'closing', settle: 'settling', trajectory: 'running', return: 'returning', release: 'opening' };

function show(kind, word, serial = '', reason = '', { cause = '', action = '', marginal = false } = {}) {
  const box = $('verdict');
  box.dataset.kind = kind;
  box.dataset.length = word.length;
  setText($('verdict-word'), word);
  setText($('verdict-serial'), serial);
  setText($('verdict-reason'), reason);
  setText($('verdict-cause'), cause);
  setText($('verdict-action'), action);
  $('verdict-cause').hidden = !cause;
  $('verdict-action').hidden = !action;
  $('verdict-marginal').hidden = !marginal;
  document.title = `${word} ${serial} – ${status?.station ?? 'clampd'}`;
}

/** A bar that is full at 1; without a share it only says that something goes on. */
function showProgress(share) {
  $('progress').hidden = false;
  if (share === null) $('progress').removeAttribute('value');
  else $('progress').value = share;
}

function showMotion() {
  if (pending) {
    showProgress(null);
    return show('running', 'STARTING', pending.serial, 'the station was asked to begin');
  }
  if (status.opening) {
    showProgress(null);
    return show('running', 'OPENING', '', 'the brake is being opened');
  }
  const { repeat, repeats, repeats_auto: atMost, phase, serial } = status;
  showProgress(repeats > 0 ? repeat / repeats : null);
  const run = repeats > 0 ? `run ${Math.min(repeat + 1, repeats)} of ${atMost ? 'at most ' : ''}${repeats}` : '';
  show('running', 'RUNNING', serial, [run, kPhases[phase] ?? ''].filter(Boolean).join(', '));
}

function showJudging() {
  judgingSince ||= performance.now();
  const seconds = Math.floor((performance.now() - judgingSince) / 1000);
  const searched = status.cause_searched ?? 0;
  showProgress(searched > 0 ? searched : null);
  const what = searched > 0 ? 'the cause is being searched for' : 'the verdict is being made';
  show('running', 'JUDGING', status.serial, `the brake is done; ${what}${seconds > 0 ? `, ${seconds} s` : ''}`);
}

function showVerdict() {
  if (!status.judging) judgingSince = 0;
  $('progress').hidden = true;
  if (moving()) showMotion();
  else if (status.judging) showJudging();
  else if (record) {
    show(record.verdict, record.verdict, record.recipe ? `${record.serial}, part ${record.part_number}` : record.serial, reasonText(record.reason),
         { cause: causeText(record.cause), action: actionText(record), marginal: record.marginal });
  } else if (status.last_verdict !== '') show('none', '…', status.serial, 'the verdict is being fetched');
  else if (status.state === 'FAULT') show('ERROR', 'FAULT', '', 'see below');
  else if (status.state === 'IDLE') show('none', 'READY', status.next_serial, status.next_serial ? 'press the start button' : 'scan or type a serial number, then Enter');
  else show('none', status.state, '', 'waiting for the brake');
}

function showInterlocks() {
  $('interlocks').replaceChildren(...status.panel.map((line) => {
    const bad = line.state === 'lost' || (line.role === 'emergency stop' && line.state !== 'closed');
    const open = line.role === 'fixture closed' && line.state === 'open';
    return element('span', { className: `pill ${bad ? 'bad' : open ? 'warn' : ''}`, title: line.line, textContent: `${line.role}: ${line.state}` });
  }));
}

function publishingTrouble(channel) {
  if (!channel.error && (channel.connected || channel.pending === 0)) return '';
  const many = channel.pending === 1 ? '1 check waits to be published; it is' : `${channel.pending} checks wait to be published; they are`;
  const waiting = channel.pending > 0 ? ` ${many} safe in the station’s database.` : '';
  return `${channel.channel} (${channel.where}): ${channel.error || 'not connected.'}${waiting}`;
}

function showNotices(texts) {
  $('notices').replaceChildren(...texts.filter(Boolean).map((text) => element('div', { textContent: text })));
}

/** More than an open brake's sensor reads, whatever its offset. */
const kStanding_N = 1000;

/** Force that stands though nothing moves: hands stay out, and the brake does not come out of its fixture. */
function showClamped() {
  const stands = !moving() && (status.clamped ?? status.force_N > kStanding_N);
  $('clamped').hidden = !stands;
  if (stands) setText($('clamped-force'), `${fixed((status.clamped_N ?? status.force_N) / 1000, 1)} kN`);
}

function showFault() {
  const fault = status.state === 'FAULT';
  if (fault && $('fault').hidden && $('serial').value === '') $('serial').blur();  // so that "c" clears
  $('fault').hidden = !fault;
  if (!fault) return;
  setText($('fault-name'), status.fault);
  setText($('fault-text'), `${status.fault_text} ${status.clearable ? '' : 'Its cause is still there.'}`);
  $('clear').disabled = !status.clearable;
}

function showStatus() {
  document.body.classList.remove('stale');
  setText($('station'), status.station);
  setText($('state'), status.state);
  $('state').className = `pill ${kStatePills[status.state] ?? 'warn'}`;
  $('simulated').hidden = !status.simulated;
  showInterlocks();
  showPartNumbers();
  setText($('link'), `${status.interface} ${status.link} · ${fixed(status.force_N / 1000, 1)} kN · ${fixed(status.velocity_rad_s, 0)} rad/s · ${fixed(status.torque_Nm, 2)} N m`);
  showNotices([status.storage, status.clock, status.notice, status.master, ...status.publishing.map(publishingTrouble)]);
  showClamped();
  showFault();
  // Not `disabled`: Enter would then do nothing, without a word.
  $('start').setAttribute('aria-disabled', status.state !== 'IDLE' || busy());
  showWhatWasDone();
  showVerdict();
}

const kBySerial = 'by serial number';

/** Where the station has recipes, whoever starts may say which part it is. */
function showPartNumbers() {
  const known = status.part_numbers ?? [];
  $('part-label').hidden = known.length === 0;
  const shown = [...$('part').options].slice(1).map((option) => option.value);
  if (shown.length === known.length && shown.every((part, i) => part === known[i])) return;
  const chosen = $('part').value;
  $('part').replaceChildren(...['', ...known].map((part) => element('option', { value: part, textContent: part || kBySerial })));
  $('part').value = known.includes(chosen) ? chosen : '';
}

/** A command is done when the station's state says so, not when it was taken. */
function showWhatWasDone() {
  if (moving() || awaited === null || !awaited.isDone()) return;
  say(awaited.words());
  awaited = null;
}

let silentSince = 0;

/** Nothing of what was known may look as if it still were: least of all a verdict. */
function showSilence(late) {
  if (silentSince === 0 && !$('message').classList.contains('alarm')) say('');
  silentSince ||= performance.now();
  const seconds = Math.floor((performance.now() - silentSince) / 1000);
  const word = late ? 'NO ANSWER' : 'NO DAEMON';
  document.body.classList.add('stale');
  setText($('state'), word);
  $('state').className = 'pill bad';
  setText($('link'), '');
  for (const id of ['fault', 'clamped', 'progress']) $(id).hidden = true;
  $('interlocks').replaceChildren();
  showNotices([late ? 'The station does not answer: nothing here is up to date.'
                    : 'The station’s daemon does not answer: nothing here is up to date. `systemctl status clampd` says why.']);
  show('silent', word, '', `What the brake does is not known${seconds > 0 ? `, for ${seconds} s now` : ''}. Use the emergency stop if it moves. This page goes on asking.`);
  $('start').setAttribute('aria-disabled', true);
}

// ---------------------------------------------------------------------------------------------- runs

const kNoRun = { run: 0, repeat: 0, force_N: [], velocity_rad_s: [], torque_Nm: [] };
let live = structuredClone(kNoRun);

async function followRun() {
  const more = await ask(`/v1/live?run=${live.run}&row=${live.force_N.length}`);
  if (more.run === live.run && more.force_N.length === 0) return;
  if (more.run !== live.run || more.from === 0) live = more;
  else for (const { key } of kChannels) live[key].push(...more[key]);
  setText($('run-name'), live.run > 0 ? `${live.repeat + 1}` : '');
  drawRun('live', live, reference);
}

function showRecord() {
  const parameters = record?.parameters ?? [];
  showParameters($('parameters'), parameters.length > 0 ? parameters : kParameterNames.map((name) => ({ name, unit: '', verdict: '' })));
  showSheet($('sheet'), record?.sheet);
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

let seen = '';  // of which check, and with which verdict, `record` is; empty: of none yet

/** The record of the last check, once there is one: of this or, where the daemon has made none yet, of none. */
async function followRecord() {
  // The verdict changes once more where a result was saved late; numbers begin anew with the daemon.
  const now = [status.id ?? status.check, status.serial, status.last_verdict].join('\n');
  if (seen === now) return;
  const judged = status.last_verdict !== '';
  const progress = judged ? await ask('/v1/checks/current') : null;
  const news = seen !== '' && judged;
  if (progress && (progress.check !== status.check || progress.id !== status.id)) {  // another one has begun meanwhile
    record = null;
    return;
  }
  seen = now;
  record = progress?.record ?? null;
  showRecord();
  if (news && record) sound(record.verdict);
}

let timer = null;
let following = false;

async function follow() {
  if (following) return;
  following = true;
  clearTimeout(timer);
  const wasSilent = status === null;
  const granted = pending?.granted ?? false;
  try {
    const answer = await ask('/v1/status');
    if (granted) pending = null;
    if (wasSilent) {
      reference = await ask('/v1/reference');
      live = structuredClone(kNoRun);
      seen = '';
      await checkSession();
    }
    // Each part number may have a trajectory of its own.
    if (!wasSilent && answer.id !== status?.id && answer.part_numbers?.length > 0) reference = await ask('/v1/reference');
    status = answer;
    silentSince = 0;
    await followRecord();
    showStatus();
    await followRun();
    if (wasSilent) drawRun('live', live, reference);
  } catch (error) {
    status = null;
    if (granted) pending = null;
    showSilence(error.late);
    if (error.status !== 0) console.error(error);
  }
  following = false;
  lastRound_ms = performance.now();
  timer = setTimeout(follow, status === null ? 500 : busy() ? 80 : 250);
}

// A page that was out of sight was not kept up to date: its timers stand still.
let lastRound_ms = 0;
document.addEventListener('visibilitychange', () => {
  if (document.hidden || performance.now() - lastRound_ms < kPatience_ms) return;
  showSilence(true);
  follow();
});

// ---------------------------------------------------------------------------------------------- starting

function say(text) {
  setText($('message'), text);
}

// What stands in the field was begun while another brake was being checked ('busy'), in another view ('elsewhere') or
// as it should be (null): only the last is started by the Enter that ends it.
let entered = null;
let fieldBefore = '';

function setField(text, from = null) {
  $('serial').value = fieldBefore = text;
  entered = text === '' ? null : from;
}

$('serial').addEventListener('input', () => {
  const text = $('serial').value;
  if (text === '') entered = null;
  else if (fieldBefore === '' && entered === null && busy()) entered = 'busy';
  fieldBefore = text;
});

let aside = '';  // the serial number that was not started

/** What was not started leaves the field, so that the next Enter starts nothing that nobody asked for then. */
function setAside(serial, why) {
  aside = serial;
  setText($('aside-text'), `${serial} was not started: ${why}`);
  $('aside').hidden = false;
  setField('');
  if (status?.state === 'FAULT') $('serial').blur();
  else $('serial').focus();
}

function dropAside() {
  aside = '';
  $('aside').hidden = true;
  $('serial').focus();
}

$('aside-use').addEventListener('click', () => {
  setField(aside, busy() ? 'busy' : null);
  dropAside();
});
$('aside-drop').addEventListener('click', dropAside);

/** Why this serial number cannot be started now; empty: it can. */
function objection() {
  if (status === null) return 'the station does not answer.';
  if (status.judging) return `the verdict on ${status.serial} is being made.`;
  if (moving()) return `a check of ${pending?.serial ?? status.serial} is under way.`;
  if (status.state === 'FAULT') return `the station is in FAULT (${status.fault}). Clear it first.`;
  if (entered === 'busy') return 'it was entered while another brake was being checked. Is it the one in the fixture?';
  return '';
}

/** What is asked for on this picture of the station is void if somebody stops it meanwhile. */
const stopsSeen = () => (status?.stops === undefined ? '' : `?stops_seen=${status.stops}`);

async function start(serial) {
  const why = objection();
  if (why) return setAside(serial, why);
  if (entered === 'elsewhere') {
    entered = null;
    return say(`${serial} was scanned outside of the station’s view. Enter starts it.`);
  }
  dropAside();
  say('');
  awaited = null;
  pending = { serial, granted: false };
  setField('');
  showStatus();
  try {
    await ask(`/v1/checks${stopsSeen()}`, { body: { serial, operator_name: $('operator').value.trim(), ...($('part').value && { part_number: $('part').value }) } });
    pending.granted = true;
  } catch (error) {
    pending = null;
    setAside(serial, error.late ? 'the station has not answered; what it made of it shows here as soon as it does.' : error.message);
    if (error.status === 401) checkSession().catch(() => {});
    if (status) showStatus();
  }
}

$('operator').value = sessionStorage.getItem('clampd.operator') ?? '';
$('operator').addEventListener('change', () => sessionStorage.setItem('clampd.operator', $('operator').value));

$('entry').addEventListener('submit', (event) => {
  event.preventDefault();
  const serial = $('serial').value.trim();
  if (serial) return start(serial);
  $('serial').focus();
  say('Scan or type the serial number first.');
});

// ---------------------------------------------------------------------------------------------- commands

let awaited = null;  // what a command is to bring about: {words, isDone}

/** Whether the station took it; its words if it did not. */
async function command(path, doing, words, isDone) {
  $('message').classList.remove('alarm');
  say(doing);
  try {
    const answer = await ask(path, { body: {}, within_ms: 2 * kPatience_ms });
    awaited = { words, isDone: () => isDone(answer) };
    return true;
  } catch (error) {
    say(error.message);
    if (error.status === 401) checkSession().catch(() => {});
    return false;
  }
}

async function stop() {
  if (await command('/v1/stop', 'Stopping …', () => 'Stopped.', () => !(status.stops_taken < status.stops))) return;
  $('message').classList.add('alarm');
  say(`THE STOP WAS NOT TAKEN, use the emergency stop: ${$('message').textContent}`);
}
const clear = () => command('/v1/clear', 'Clearing …', () => 'Cleared.', () => status.state !== 'FAULT').then(() => $('serial').focus());
const openBrake = () => command(`/v1/open${stopsSeen()}`, 'Opening …', () => status.open_reason || 'Opened.', ({ id }) => status.open_id === id);
$('stop').addEventListener('click', stop);
$('clear').addEventListener('click', clear);
$('open').addEventListener('click', openBrake);

$('unlock').addEventListener('submit', async (event) => {
  event.preventDefault();
  keepToken($('token').value.trim());
  $('token').value = '';
  await checkSession().catch(() => {});
});

// ---------------------------------------------------------------------------------------------- views

const view = (name) => !$(`view-${name}`).hidden;

function openView(name) {
  for (const button of document.querySelectorAll('nav button[data-view]')) {
    const chosen = button.dataset.view === name;
    $(`view-${button.dataset.view}`).hidden = !chosen;
    if (chosen) button.setAttribute('aria-current', 'page');
    else button.removeAttribute('aria-current');
  }
  if (name === 'station') {
    if (reference) drawRun('live', live, reference);
    showRecord();
    $('serial').focus();
  }
  if (name === 'history') listHistory(reference);
  if (name === 'statistics') showStatistics();
}

for (const button of document.querySelectorAll('nav button[data-view]')) button.addEventListener('click', () => openView(button.dataset.view));

window.addEventListener('resize', () => {
  if (view('station') && reference) {
    drawRun('live', live, reference);
    showRecord();
  }
  if (view('statistics')) drawStatistics();
});

// ---------------------------------------------------------------------------------------------- keyboard

// A scanner types like a keyboard, wherever the focus is: what it types belongs into the field, and a "c" that others
// follow at once is part of a number, no command.
const kAloneFor_ms = 250;
let waitingClear = null;

/** The key that comes next goes to the field, after `before`. */
function leadToField(before) {
  if ($('entry').hidden) return say('A scan was not taken: this screen may look, but not start anything.');
  const elsewhere = !view('station');
  if (elsewhere) openView('station');
  $('serial').focus();
  const from = $('serial').value !== '' ? entered : busy() ? 'busy' : elsewhere ? 'elsewhere' : null;
  setField($('serial').value + before, from);
  entered = from;  // also of a field that is empty yet
}

function isCommand(event) {
  if (event.key === 'Escape') {
    if (!event.repeat && (busy() || status === null)) stop();
    return true;
  }
  const views = { F2: 'station', F3: 'history', F4: 'statistics' };
  if (views[event.key]) openView(views[event.key]);
  if (event.key === 'F9' && !$('clamped').hidden && !event.repeat) openBrake();
  return event.key in views || event.key === 'F9';
}

document.addEventListener('keydown', (event) => {
  const held = waitingClear === null ? '' : 'c';
  clearTimeout(waitingClear);
  waitingClear = null;
  if (isCommand(event)) return event.preventDefault();
  const typing = event.target instanceof HTMLInputElement || event.target instanceof HTMLSelectElement;
  const printable = event.key.length === 1 && event.key !== ' ';
  if (typing || event.repeat || event.ctrlKey || event.altKey || event.metaKey || !(printable || (held && event.key === 'Enter'))) return;
  if (!held && event.key === 'c' && status?.state === 'FAULT') waitingClear = setTimeout(() => { waitingClear = null; clear(); }, kAloneFor_ms);
  else leadToField(held);
});

showRecord();
follow();
