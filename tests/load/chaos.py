#!/usr/bin/env python3
"""All rows but the soak, one after another; the last lines say how each went.

Options are passed on (--quick, --binary); a name or more, as `slow` or `overload`, runs those only.
"""

import subprocess
import sys
import time
from pathlib import Path

ROWS = {
    "malformed": 1,
    "bombs": 2,
    "slow": 4,
    "uploads": 5,
    "overload": 6,
    "sigterm": 7,
    "disconnect": 8,
    "contract": 10,
    "models": 12,
    "api_key": 13,
    "guard": 15,
    "kill": 16,
    "strangers": 17,
    "strangers_jobs": 18,
    "replicas": 19,
    "clock": 20,
}


def main():
    asked = [name for name in sys.argv[1:] if name in ROWS]
    passed_on = [option for option in sys.argv[1:] if option not in ROWS]
    if "-h" in passed_on or "--help" in passed_on:
        sys.exit(f"{__doc__}\nNames: {', '.join(ROWS)}")
    went = []
    for name in asked or ROWS:
        started = time.monotonic()
        script = Path(__file__).parent / f"{name}.py"
        code = subprocess.run([sys.executable, script, *passed_on], check=False).returncode
        word = {0: "ok", 1: "FAILED"}.get(code, f"FAILED with exit code {code}")
        went.append((name, word, time.monotonic() - started))
    print()
    for name, word, seconds in went:
        print(f"row {ROWS[name]:>2}  {name:<14}  {word}, {seconds:.0f} s")
    sys.exit(any(word != "ok" for _, word, _ in went))


if __name__ == "__main__":
    main()
