// Filters over the cards of the gallery: one for each kind of class, such as robot--epuck.
const cards = [...document.querySelectorAll(".card")];
if (cards.length) {
  const bar = document.createElement("div");
  bar.className = "filters";
  const count = document.createElement("span");
  count.setAttribute("role", "status");
  const choices = ["robot", "sensor", "algorithm"].map((kind) => {
    const names = cards.flatMap((card) => [...card.classList].filter((name) => name.startsWith(kind + "--")));
    const select = document.createElement("select");
    select.append(new Option("any", ""));
    for (const name of [...new Set(names)].sort()) select.append(new Option(name.slice(kind.length + 2).replaceAll("_", " "), name));
    const label = document.createElement("label");
    label.append(kind + " ", select);
    bar.append(label);
    return select;
  });
  const show = () => {
    for (const card of cards) card.hidden = !choices.every((select) => !select.value || card.classList.contains(select.value));
    count.textContent = `${cards.filter((card) => !card.hidden).length} of ${cards.length}`;
  };
  bar.append(count);
  bar.addEventListener("change", show);
  document.querySelector(".cards").before(bar);
  show();
}
