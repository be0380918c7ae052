// Requests to the server and its stream of events. Nothing here knows the page.

export async function ask(path, parameters = {}) {
  const query = new URLSearchParams();
  for (const [key, value] of Object.entries(parameters)) if (value !== null && value !== undefined && value !== "") query.set(key, value);
  const text = query.toString();
  const response = await fetch(`/api/${path}${text ? "?" + text : ""}`, { cache: "no-store" });
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

export async function send(path, document) {
  const response = await fetch(`/api/${path}`, {
    method: "POST",
    headers: { "content-type": "application/json", "x-he3-console": "1" },
    body: JSON.stringify(document),
  });
  if (!response.ok) throw await failure(response);
  return response.json();
}

// The server's reason, with the status code.
async function failure(response) {
  let why = `${response.status} ${response.statusText}`;
  try { why = (await response.json()).error; } catch { /* no reason was given */ }
  return Object.assign(new Error(why), { status: response.status });
}

// Server-sent events; the browser reconnects by itself when they break off, and then gets everything afresh.
export function listen(handlers, onBreak) {
  const source = new EventSource("/api/stream");
  for (const [kind, handler] of Object.entries(handlers)) {
    source.addEventListener(kind, (event) => handler(JSON.parse(event.data)));
  }
  source.onerror = onBreak;
  return source;
}
