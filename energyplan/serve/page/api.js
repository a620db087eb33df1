// Requests to the service. Each function returns the service's JSON or throws its own message.

const token = new URLSearchParams(location.hash.slice(1)).get("token");
const headers = token ? { Authorization: `Bearer ${token}` } : {};

async function answered(response) {
  if (response.ok) return response.json();
  let told = response.statusText;
  try { told = (await response.json()).detail; } catch { /* no JSON: the status has to do */ }
  throw new Error(told);
}

export async function get(path) {
  return answered(await fetch(`api/${path}`, { headers }));
}

export async function post(path, body, signal) {
  const sent = { ...headers, "Content-Type": "application/json" };
  return answered(await fetch(`api/${path}`, {
    method: "POST", headers: sent, body: JSON.stringify(body), signal,
  }));
}

export async function upload(name, file) {
  return answered(await fetch(`api/files/${name}`, { method: "PUT", headers, body: file }));
}
