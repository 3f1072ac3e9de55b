// The form of `machopt view`: what it adds is what is sent to the planner, in the keys of a plan file.
const by = id => document.getElementById(id), sent = [];
window.fetch = async (what, asked) => { if (asked) sent.push([what, JSON.parse(asked.body)]); return { json: async () => ({ message: "heard", good: true, stage: "" }) }; };
const choose = (id, text) => { const select = by(id); select.value = [...select.options].find(o => o.textContent === text).value; select.onchange(); };
found.refused = [];
for (const [where, what, values] of GIVEN.wishes) {
  choose("where", where);
  choose("what", what);
  for (const [name, value] of Object.entries(values)) (by(name) || by("values").querySelector(`[name=${name}]`)).value = value;
  const wrong = [...by("wish").querySelectorAll("input:invalid")].map(e => `${what}: ${e.name || e.id} ${e.value}: ${e.validationMessage}`);
  found.refused.push(...wrong);
  by("wish").requestSubmit();
}
found.told = by("status-message").textContent;
found.listed = [...document.querySelectorAll("#wishes .wish")].map(e => e.textContent.trim());
by("replan").click();
await wait(50);
found.sent = sent;
