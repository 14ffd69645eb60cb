// The theme puts the copy button of each block into a landmark; a page then has dozens of the same name.
new MutationObserver(() => {
  document.querySelectorAll("nav.md-code__nav:not([role])").forEach(nav => nav.setAttribute("role", "none"));
}).observe(document.documentElement, { childList: true, subtree: true });
