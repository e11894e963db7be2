"""Report of the endurance test (``bench.dev.soak``): a table with counts of cases and failures."""

from xml.etree import ElementTree as Xml

from bench.dev import soak

REPORT = """<testsuites><testsuite>
<testcase name="a"><properties><property name="row" value="files"/><property name="tried" value="1200"/></properties>
</testcase>
<testcase name="b"><properties><property name="row" value="files"/></properties><failure>no</failure></testcase>
<testcase name="c"><properties><property name="row" value="forks"/></properties><error>no</error></testcase>
<testcase name="d"><properties><property name="row" value="forks"/></properties><skipped/></testcase>
<testcase name="e"><properties><property name="row" value="forks"/></properties></testcase>
<testcase name="a whole file"><skipped/></testcase>
</testsuite></testsuites>"""


def test_cases_and_failures_are_counted_by_rows():
    rows = soak.rows(Xml.fromstring(REPORT).iter("testcase"))  # noqa: S314 (parses the text above)
    assert rows == {"files": soak.Row(1201, 1, 0), "forks": soak.Row(2, 1, 1)}
    assert soak.table(rows).splitlines()[2:] == ["| files | 1,201 | 1,200 | 1 |", "| forks | 2 (1 skipped) | 1 | 1 |"]
