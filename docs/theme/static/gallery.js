// Filters over the cards of the gallery. The emphasized line of a card holds its robots, sensors, algorithms and difficulties.
const cards = [...document.querySelectorAll(".card")].map((element) => {
  const facts = element.querySelector("em").textContent.split(" · ");
  return { element, facts: facts.map((names) => names.split(", ")) };
});
if (cards.length) {
  const bar = document.createElement("div");
  const count = document.createElement("span");
  bar.className = "filters";
  count.setAttribute("role", "status");
  const selects = ["robot", "sensor", "algorithm", "difficulty"].map((kind, index) => {
    const select = document.createElement("select");
    const names = new Set(cards.flatMap((card) => card.facts[index]));
    select.append(new Option("any", ""), ...[...names].sort().map((name) => new Option(name)));
    const label = document.createElement("label");
    label.append(kind + " ", select);
    bar.append(label);
    return select;
  });
  const show = () => {
    for (const card of cards) {
      card.element.hidden = !selects.every((select, index) => !select.value || card.facts[index].includes(select.value));
    }
    count.textContent = `${cards.filter((card) => !card.element.hidden).length} of ${cards.length}`;
  };
  bar.append(count);
  bar.addEventListener("change", show);
  document.querySelector(".cards").before(bar);
  show();
}
