// The control API of the daemon that served the page (include/clampd/api/messages.hpp); nobody else is asked anything.

const kTokenKey = 'clampd.token';
const fromAddress = new URLSearchParams(location.hash.slice(1)).get('token');
if (fromAddress) {
  keepToken(fromAddress);
  history.replaceState(null, '', location.pathname);  // nobody shall read it off the address line
}

export function keepToken(token) {
  sessionStorage.setItem(kTokenKey, token);
}

/** How long the station's state may stay unknown before the page says so. */
export const kPatience_ms = 1500;
/** For what reads much of the archive. */
export const kArchivePatience_ms = 20000;

/**
 * The answer's document: of a POST if there is a `body`, of a GET if not. Throws an Error with the station's words. Its
 * `status` is 0 where no answer came; `late` then says that somebody took the question and kept silent.
 */
export async function ask(path, { body, within_ms = kPatience_ms } = {}) {
  const headers = {};
  const token = sessionStorage.getItem(kTokenKey);
  if (token) headers.Authorization = `Bearer ${token}`;
  if (body !== undefined) headers['Content-Type'] = 'application/json';
  let response;
  let answer;
  try {
    const method = body === undefined ? 'GET' : 'POST';
    response = await fetch(path, { method, headers, body: body && JSON.stringify(body), signal: AbortSignal.timeout(within_ms) });
    answer = await response.json();
  } catch (error) {
    const late = error.name === 'TimeoutError';
    throw Object.assign(new Error(late ? 'the station does not answer' : 'no answer from the station’s daemon'), { status: 0, late });
  }
  if (!response.ok) throw Object.assign(new Error(answer.error ?? `status ${response.status}`), { status: response.status });
  return answer;
}
