// Requests to the service. Each function returns the service's JSON or throws its own message.

import { t } from "./texts.js";

const token = new URLSearchParams(location.hash.slice(1)).get("token");
const headers = token ? { Authorization: `Bearer ${token}` } : {};

async function answered(response) {
  if (response.ok) return response.json();
  if (response.status === 401) throw new Error(t("no_token"));  // the service's words are for programs
  let told = response.statusText;
  try { told = (await response.json()).detail; } catch { /* no JSON: the status has to do */ }
  throw new Error(told);
}

export async function get(path) {
  return answered(await fetch(`api/${path}`, { headers }));
}

// Ask; `told` is called with what the service says on the way, such as how far it has compiled.
export async function post(path, body, told = () => {}, signal = undefined) {
  const sent = { ...headers, "Content-Type": "application/json", Accept: "text/event-stream" };
  const response = await fetch(`api/${path}`, { method: "POST", headers: sent, body: JSON.stringify(body), signal });
  if (!response.ok) return answered(response);
  const reader = response.body.pipeThrough(new TextDecoderStream()).getReader();
  for (let text = "", part; !(part = await reader.read()).done;) {
    const events = (text + part.value).split("\n\n");
    text = events.pop();
    for (const event of events) {
      const [, kind, data] = /^event: (\w+)\ndata: (.*)$/s.exec(event), document = JSON.parse(data);
      if (kind === "answer") return document;
      if (kind === "problem") throw new Error(document.detail);
      told(document);
    }
  }
  throw new Error(t("ended"));
}

export async function upload(name, file) {
  return answered(await fetch(`api/files/${name}`, { method: "PUT", headers, body: file }));
}
