// What the codes of records mean to who stands at the bench, and what to do next.

const kParameterWords = {
  k1: 'stiffness, cubic', k2: 'stiffness', TC: 'Coulomb friction', Ts0: 'static friction', Tv: 'viscous friction',
  mus: 'friction under load', ws: 'Stribeck speed',
};
export const kParameterNames = Object.keys(kParameterWords);

/** "stiffness" of k2; empty for the parameter of an effect, whose name is words already. */
export const parameterWords = (name) => kParameterWords[name] ?? '';

/** A reason with words before the codes: "stiffness k2 is 24.6 N/rad², below its lower limit …". */
export const reasonText = (reason) =>
  reason.replace(/(^|[;.:] )(k1|k2|TC|Ts0|Tv|mus|ws)(?= is )/g, (_, before, name) => `${before}${kParameterWords[name]} ${name}`)
      .replaceAll('N/rad^2', 'N/rad²').replaceAll('N/rad^3', 'N/rad³');

const kEffectWords = {
  'torque-offset': 'the torque reading has an offset', 'torque-gain': 'the torque reading is scaled', 'torque-lag': 'the torque acts late',
  'coulomb-load': 'friction that grows with clamp force', 'friction-asymmetry': 'friction that differs by direction', 'quadratic-drag': 'drag that grows with the square of speed',
  cogging: 'cogging of the motor', 'inertia-error': 'another inertia than configured', 'ratio-error': 'another gear ratio than configured',
  presliding: 'compliance before sliding', 'friction-drift': 'friction that changes from run to run', 'stiffness-hysteresis': 'less force on release than on apply',
  'pad-damping': 'a damping pad', 'pad-relaxation': 'a pad that relaxes', backlash: 'backlash', 'stiffness-shape': 'another shape of stiffness',
  'force-offset': 'the force reading has an offset', 'force-lag': 'the force reading comes late', 'force-saturation': 'the force reading is clipped', 'force-hum': 'mains hum on the force reading',
  'velocity-offset': 'the speed reading has an offset', 'velocity-lag': 'the speed reading comes late', 'channel-skew': 'one reading is samples late', outliers: 'single readings far off',
};
const kLocationWords = {
  'torque-balance': 'motor, gear and friction', stiffness: 'pads and caliper', 'force-reading': 'the force reading', 'velocity-reading': 'the speed reading',
  'torque-reading': 'the torque reading', timing: 'the timing of the readings',
};
const kLocationActions = {
  'torque-balance': 'Look at motor, gear and bearings for what rubs or is loose.',
  stiffness: 'Look at pads, caliper and their seat for what is worn, loose or missing.',
  'force-reading': 'Have the force sensor looked at: mounting, cable, filter, calibration.',
  'velocity-reading': 'Have the speed sensor looked at: mounting, cable, filter.',
  'torque-reading': 'Have the drive’s torque reading looked at: zero, scale, delay.',
  timing: 'Have the order and delay of the readings on the bus looked at.',
};

const effectText = (name) => (kEffectWords[name] ? `${kEffectWords[name]} (${name})` : name);

/** "Cause: the force reading comes late (force-lag)"; empty without one. */
export function causeText(cause) {
  if (!cause) return '';
  if (cause.rivals.length > 0) return `Cause: one of ${cause.rivals[0].map(effectText).join('; ')}`;
  if (cause.effect) return `Cause: ${cause.effects.map(effectText).join('; and ')}`;
  return cause.location ? `Cause: unknown, in ${kLocationWords[cause.location] ?? cause.location}` : 'Cause: unknown';
}

const kActions = {
  PASS: 'Take the brake out, then scan the next one.',
  FAIL: 'Put this brake aside as failed.',
  ERROR: 'Nothing is said about this brake. Check it again; if this comes back, call maintenance.',
  TIMEOUT: 'Nothing is said about this brake. See that it moves freely and check it again.',
  ABORTED: 'Nothing is said about this brake. Check it again.',
};

/** What to do now that this check is over. */
export function actionText(record) {
  if (record.verdict === 'PASS' && record.marginal) return 'Passed, close to a limit. Take the brake out, then scan the next one.';
  if (record.verdict === 'PASS' && record.systematic_misfit?.marked) return 'Passed, with a note for maintenance. Take the brake out, then scan the next one.';
  const where = record.verdict === 'ERROR' && kLocationActions[record.cause?.location];
  return where ? `Nothing is said about this brake. ${where} Then check it again.` : kActions[record.verdict] ?? '';
}
