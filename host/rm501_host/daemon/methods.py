"""Every method of the API, declared once: name, parameters, access, what it does. `docs/api.md` is made from it.

Methods that move the arm answer at once with {"motion": number}; `motion.wait` waits for its end. One file a group;
the order of the imports is that of the document.
"""

from __future__ import annotations

from rm501_host.daemon import methods_status  # isort: skip
from rm501_host.daemon import methods_control  # isort: skip
from rm501_host.daemon import methods_motion  # isort: skip
from rm501_host.daemon import methods_program  # isort: skip
from rm501_host.daemon import methods_path  # isort: skip
from rm501_host.daemon import methods_teach  # isort: skip
from rm501_host.daemon import methods_tables  # isort: skip
from rm501_host.daemon.declared import api

__all__ = [
    "api",
    "methods_control",
    "methods_motion",
    "methods_path",
    "methods_program",
    "methods_status",
    "methods_tables",
    "methods_teach",
]
