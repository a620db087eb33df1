// What the page says, in the languages of texts/: each a file of the same keys. Nothing else here or in the page
// is in any language; names of maps, terms and tasks, and what the service says of an error, stay as they come.

const LANGUAGES = ["en", "de"];  // those of the page's select
let table = {}, plural = new Intl.PluralRules("en");
export let language = "en";

// The language that was chosen before, or the first of the browser's that there is.
export function preferred() {
  const wanted = [localStorage.getItem("language"), ...navigator.languages.map((name) => name.slice(0, 2))];
  return wanted.find((name) => LANGUAGES.includes(name)) ?? LANGUAGES[0];
}

export async function speak(name) {
  table = await (await fetch(`texts/${name}.json`)).json();
  language = name;
  plural = new Intl.PluralRules(name);
  document.documentElement.lang = name;
  relabel(document.querySelectorAll("*"));
}

// A text of the table with its {values} filled in.
export function t(key, values = {}) {
  if (!(key in table)) throw new Error(key);
  return Array.isArray(table[key]) ? table[key] : table[key].replace(/\{(\w+)\}/g, (_, name) => values[name]);
}

export const counted = (key, count, values = {}) => t(`${key}.${plural.select(count)}`, { count, ...values });

export const known = (key) => key in table;

export function number(value, digits = 0) {
  return value.toLocaleString(language, { minimumFractionDigits: digits, maximumFractionDigits: digits });
}

// Set the texts that elements name: their own, a placeholder, a label or a title.
const PARTS = { text: "textContent", placeholder: "placeholder", label: "ariaLabel", hint: "title" };
export function relabel(elements) {
  for (const one of elements) {
    for (const [part, property] of Object.entries(PARTS)) {
      if (part in one.dataset) one[property] = t(one.dataset[part], one.dataset);
    }
  }
}
