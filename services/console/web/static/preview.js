// What a command would do, before it is sent: Enter sends it, Escape does not. The dialog lies over the page, so nothing
// moves while the operator decides.

import { map } from "./layers.js";
import { send } from "./net.js";
import { $, state, toast } from "./state.js";
import { showTimeline } from "./timeline.js";
import { element, words } from "./words.js";

const READ_MS = 600; // how long the preview stands before it can be sent: no second click or key sends it unread
const ALERTS = new Set(["REFUSED", "WARNING"]);
const dialog = $("preview"), button = $("preview-send");

// Shows what the command would do. Resolves with whether the operator sends it; throws if nothing can be said of it.
export async function isSent(wanted) {
  $("preview-title").textContent = `${words(wanted.kind)}${wanted.area_id ? ` ${wanted.area_id}` : ""}`;
  $("preview-said").replaceChildren(element("p", { class: "dim" }, "Asking the ground …"));
  button.disabled = true;
  dialog.showModal();
  dialog.focus();
  const answer = new Promise((resolve) => { dialog.onclose = () => resolve(dialog.returnValue === "send"); });
  dialog.returnValue = "";
  try {
    const outlook = await send("preview", wanted);
    if (dialog.open) show(outlook);
    return await answer;
  } finally {
    dialog.close(dialog.returnValue);
    map.preview = state.preview = null;
    map.draw();
    showTimeline();
  }
}

function show(outlook) {
  const { lines, path_m, objection } = outlook;
  const rows = lines.map(([name, text]) => element("tr", { class: ALERTS.has(name) ? "alert" : "" }, element("th", { scope: "row" }, name.toLowerCase()), element("td", {}, text)));
  $("preview-said").replaceChildren(element("table", { class: "result num" }, element("tbody", {}, ...rows)));
  map.preview = path_m;
  map.draw();
  state.preview = outlook;
  showTimeline();
  if (objection) { $("preview-close").focus(); return; }
  const shown = rows[0];
  setTimeout(() => {
    if (!dialog.open || !shown.isConnected) return;
    button.disabled = false;
    button.focus();
  }, READ_MS);
}

// What was previewed on another server, or in another mission, is not sent to this one.
export function forgetPreview() {
  if (!dialog.open) return;
  dialog.close("");
  toast("The page has connected anew: nothing was sent", true);
}

// The second click of the double click that has opened the dialog may come at one of its controls: it decides nothing.
dialog.addEventListener("click", (event) => { if (event.detail > 1) { event.stopPropagation(); event.preventDefault(); } }, true);
button.addEventListener("click", () => dialog.close("send"));
$("preview-close").addEventListener("click", () => dialog.close(""));
