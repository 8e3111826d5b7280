"""Run the long acceptance sections; see tools/acceptance/sections.py.

python tools/acceptance.py [--only SECTION]... [--assets FOLDER] [--page]
"""

from __future__ import annotations

from tools.acceptance.sections import main

if __name__ == "__main__":
    main()
