"""Sphinx settings of the documentation site: `make docs`."""

project = "RODEO"
author = "M. Groshev, E. Castelló Ferrer"
extensions = ["myst_parser", "sphinxcontrib.mermaid"]
exclude_patterns = ["requirements.txt"]
html_theme = "furo"
html_title = "RODEO"
html_show_copyright = False
html_copy_source = False
# Most blocks are typed into a shell or a site file, and are not marked with a language.
highlight_language = "none"
# The same anchors as on GitHub.
myst_heading_anchors = 4
myst_fence_as_directive = ["mermaid"]
