"""The closing line of a suite in Python as cargo's tests have it, for the line over all: suite_result.py SUITE LOG."""

import re
import sys

suite, log = sys.argv[1:]
with open(log) as lines:
    last = [line for line in lines if re.search(r"\d+ (passed|failed|error|skipped)", line)][-1:]


def count(what: str) -> int:
    return sum(int(number) for number in re.findall(rf"(\d+) (?:{what})", "".join(last)))


passed, failed, skipped = count("passed"), count("failed|error"), count("skipped")
print(f"test result: {suite}. {passed} passed; {failed} failed; {skipped} ignored")
