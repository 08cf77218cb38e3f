// What every part of the page needs: elements, texts, times. Texts reach the page as text nodes only: a serial number is
// never markup.

export const $ = (id) => document.getElementById(id);

export function element(tag, properties = {}, ...children) {
  const node = document.createElement(tag);
  Object.assign(node, properties);
  node.append(...children);
  return node;
}

export const setText = (node, text) => {
  if (node.textContent !== text) node.textContent = text;
};

/** Without the minus that a rounded zero would keep. */
export const fixed = (value, digits) => (Number(value.toFixed(digits)) + 0).toFixed(digits);

export const unitText = (unit) => unit.replaceAll('^2', '²').replaceAll('^3', '³');

/** Every time on the page is UTC and says so, as in records, reports and terminal. */
export const utcText = (time) => `${new Date(time).toISOString().slice(0, 19).replace('T', ' ')} UTC`;

/** The same moment on this screen's clock, for who points at it. */
export const localText = (time) => `${new Date(time).toLocaleString('sv-SE')} on this screen's clock`;
