// The log's lines: events, commands, plans, the link, interests, authority and alarms, in the order in which they were
// known on Earth. They are those of `he3 log`.

import { fixed, words } from "./words.js";

const ALERTS = new Set(["blocked", "safe_mode_entered", "low_energy", "plan_rejected", "round_aborted", "instrument_silent", "no contact", "rejected", "failed", "expired", "lost"]);

export const KINDS = ["event", "command", "link", "alarm", "plan", "decision", "interest", "authority", "goal"];

export function logLines({ events, entries, commands, contacts, alarms }) {
  const lines = [];
  const add = (at, known_at, kind, name, text, by = "") => lines.push({ at, known_at, kind, name, text, by, alert: ALERTS.has(name) || name.endsWith(" raised") });
  for (const event of events) {
    const about = [event.round ? `round ${event.round}` : "", event.sample_id ?? "", `(${fixed(event.x_m, 1)}, ${fixed(event.y_m, 1)}) m`, event.detail];
    add(event.at, event.received_at, "event", event.kind, about.filter(Boolean).join(", "));
  }
  for (const entry of entries) add(entry.at, entry.at, entry.kind, entry.kind, entry.text, entry.by);
  for (const { command, stages, by } of commands) {
    const about = `${command.kind.replaceAll("_", "-")} ${command.command_id}`;
    for (const { stage, at, why } of stages) add(at, at, "command", stage, why ? `${about}: ${why}` : about, by);
  }
  for (const change of contacts?.events ?? []) {
    const name = change.what ? "changed" : change.contact ? "contact" : "no contact";
    add(change.at, change.at, "link", name, change.what || (change.contact ? "contact with the Moon" : "no contact with the Moon"), change.by);
  }
  for (const alarm of [...alarms.history, ...alarms.current]) {
    add(alarm.raised_at, alarm.raised_at, "alarm", `${alarm.kind} raised`, alarm.text);
    if (alarm.ended_at) add(alarm.ended_at, alarm.ended_at, "alarm", `${alarm.kind} over`, alarm.text);
  }
  return lines.sort((a, b) => a.known_at - b.known_at || a.at - b.at);
}

export function chosen(lines, kinds, text) {
  const wanted = text.trim().toLowerCase();
  return lines.filter((line) => kinds.has(line.kind) && `${line.kind} ${words(line.name)} ${line.text} ${line.by}`.toLowerCase().includes(wanted));
}

const iso = (ns) => new Date(ns / 1e6).toISOString();
const documents = (lines) => lines.map(({ alert, ...line }) => ({ ...line, at_utc: iso(line.at), known_at_utc: iso(line.known_at) }));

export const asJson = (lines) => JSON.stringify(documents(lines), null, 2);

export function asCsv(lines) {
  const names = ["at", "known_at", "kind", "name", "text", "by", "at_utc", "known_at_utc"];
  // A spreadsheet takes a text that begins so for a formula.
  const cell = (value) => { const text = /^[=+\-@]/.test(value) ? `'${value}` : String(value); return /[",\n]/.test(text) ? `"${text.replaceAll('"', '""')}"` : text; };
  return [names, ...documents(lines).map((line) => names.map((name) => line[name]))].map((row) => row.map(cell).join(",")).join("\n") + "\n";
}
