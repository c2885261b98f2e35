"""Every test runs with the shapes and types in the annotations checked at run time."""

from jaxtyping import install_import_hook

install_import_hook("marl_clean", "beartype.beartype")
