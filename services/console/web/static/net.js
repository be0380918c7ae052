// Requests to the server and its stream of events. Nothing here knows the page.

const GONE = "the page's server does not answer";
const ANSWERED_WITHIN_MS = 45_000; // longer than the server waits for the mission
const REFUSED_MS = 5000; // until a stream that the server has refused is asked for again
let stream = null, hasBroken = false;

export async function ask(path, parameters = {}) {
  const query = new URLSearchParams();
  for (const [key, value] of Object.entries(parameters)) if (value !== null && value !== undefined && value !== "") query.set(key, value);
  const text = query.toString();
  const response = await fetch(`/api/${path}${text ? "?" + text : ""}`, { cache: "no-store" }).catch(() => { throw new Error(GONE); });
  if (!response.ok) throw await failure(response);
  return response;
}

export async function askJson(path, parameters) {
  return (await ask(path, parameters)).json();
}

// The reply as a file of the browser's user, under the name that the server gives it.
export async function download(path, parameters) {
  const response = await ask(path, parameters);
  const name = /filename="([^"]+)"/.exec(response.headers.get("content-disposition") ?? "")?.[1] ?? "download";
  saveBlob(name, await response.blob());
}

// A text as a file of the browser's user.
export const save = (name, type, text) => saveBlob(name, new Blob([text], { type }));

function saveBlob(name, blob) {
  const link = document.createElement("a");
  link.download = name;
  link.href = URL.createObjectURL(blob);
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 60_000);
}

// Nothing is sent while the stream is broken off: the page does not know then what it would be sent to.
export async function send(path, document) {
  if (hasBroken && stream.readyState !== EventSource.OPEN) throw new Error(`${GONE}: nothing was sent`);
  const response = await fetch(`/api/${path}`, {
    method: "POST",
    headers: { "content-type": "application/json", "x-he3-console": "1" },
    body: JSON.stringify(document),
    signal: AbortSignal.timeout(ANSWERED_WITHIN_MS),
  }).catch(() => { throw new Error(`${GONE}: whether it has got this is not known; Commands and the log will show it`); });
  if (!response.ok) throw await failure(response);
  return response.json();
}

// The server's reason, with the status code.
async function failure(response) {
  let why = `${response.status} ${response.statusText}`;
  try { why = (await response.json()).error; } catch { /* no reason was given */ }
  return Object.assign(new Error(why), { status: response.status });
}

// Server-sent events; the browser reconnects by itself when they break off, and then gets everything afresh. Where the server
// refuses, as it does with too many browsers, the browser gives up, and this asks again.
export function listen(handlers, onBreak) {
  stream = new EventSource("/api/stream");
  for (const [kind, handler] of Object.entries(handlers)) {
    stream.addEventListener(kind, (event) => handler(JSON.parse(event.data)));
  }
  stream.onerror = () => {
    hasBroken = true;
    onBreak();
    if (stream.readyState === EventSource.CLOSED) setTimeout(() => listen(handlers, onBreak), REFUSED_MS);
  };
}
