"""How Sphinx builds these pages (see testing.md); they ask for nothing on other hosts."""

project = html_title = "pamid"
extensions = ["myst_parser", "sphinx.ext.autodoc", "numpydoc"]
myst_heading_anchors = 3
highlight_language = "none"
default_role = "py:obj"
autodoc_member_order = "bysource"
autodoc_typehints = "none"
numpydoc_show_class_members = False
toc_object_entries_show_parents = "hide"
html_theme = "furo"
html_copy_source = html_show_copyright = html_show_sphinx = False


def link_to_the_front_page(app, name, source):
    """Have the README, which is the front page here, linked as such."""
    source[0] = source[0].replace("](../README.md)", "](index.md)")


def setup(app):
    """Register what Sphinx calls."""
    app.connect("source-read", link_to_the_front_page)
