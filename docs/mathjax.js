// Formulas between \( \) and \[ \] in elements that pymdownx.arithmatex marks, set with the MathJax beside this site.
window.MathJax = {
  tex: { inlineMath: [["\\(", "\\)"]], displayMath: [["\\[", "\\]"]], tags: "none" },
  svg: { fontCache: "global", mtextInheritFont: true },
  options: { ignoreHtmlClass: ".*|", processHtmlClass: "arithmatex", enableMenu: false },
};
