// Order of search results: words of the query in a title first, pages written by hand before generated ones.
var Scorer = {
  objNameMatch: 11, objPartialMatch: 6, objPrio: {0: 15, 1: 5, 2: -5}, objPrioDefault: 0,
  title: 15, partialTitle: 7, term: 5, partialTerm: 2,
  score: ([page, title, , , score]) => {
    const words = (new URLSearchParams(window.location.search).get("q") || "").toLowerCase().split(/[^a-z0-9]+/);
    const inTitle = words.filter(word => word.length > 2 && title.toLowerCase().includes(word)).length;
    const isGenerated = /^(docs\/)?(reference|results|scenarios)\//.test(page) || /(CHANGELOG|measured|architecture)$/.test(page);
    return score + 12 * inTitle - (isGenerated ? 15 : 0);
  },
};
