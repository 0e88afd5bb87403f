// What the page asks of the server of a batch, and how it hears that it may not, or that nobody answers.

const PATIENCE_MS = 20_000;
const COMPUTING_MS = 180_000; // a server that was just set up compiles first

/** The server answered, and refused. `value`: what it said besides. */
export class Refusal extends Error {
  constructor(status, value) {
    super(value.error ?? `the server answered ${status}`);
    Object.assign(this, { status, value });
  }
}

/** Nobody answered, or the server failed: the same may go through later. */
export class Absence extends Error {}

/** Ask for `api/<path>`, with a value as JSON where there is one, until a signal says that nobody waits any more; the answer's value. */
export async function ask(method, path, value, ending = null) {
  const patience = AbortSignal.timeout(/^(figures|settle|answers)\//.test(path) ? COMPUTING_MS : PATIENCE_MS);
  const options = { method, signal: ending ? AbortSignal.any([patience, ending]) : patience };
  if (value !== undefined) Object.assign(options, { headers: { "content-type": "application/json" }, body: JSON.stringify(value) });
  let answer;
  try {
    answer = await fetch(`api/${path}`, options);
  } catch {
    throw new Absence("the server does not answer");
  }
  const said = await answer.json().catch(() => ({}));
  if (answer.status === 401) throw new Absence("the server does not know this page: open the address that it printed");
  if (answer.status >= 500 || answer.status === 408) throw new Absence(said.error ?? `the server answered ${answer.status}`);
  if (!answer.ok) throw new Refusal(answer.status, said);
  return said;
}

/** An object's, or a scene's, key as a path. */
export const keyPath = (key) => key.split("/").map(encodeURIComponent).join("/");
