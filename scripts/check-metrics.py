#!/usr/bin/env python3
"""Checks the queries for the server's metrics: the Grafana dashboard and the alerts of Prometheus.

Every query must be PromQL that parses and use only metrics that the server has, with labels that
these metrics have; the dashboard must show every metric, and be laid out without overlaps.

Usage: scripts/check-metrics.py DASHBOARD.json ALERTS.yml
Needs promql-parser and PyYAML: scripts/check-deploy.sh installs them.
"""

import json
import re
import sys

import promql_parser
import yaml

COUNTER, GAUGE, HISTOGRAM = "counter", "gauge", "histogram"
# As in src/server/metrics.rs and src/server/process.rs.
METRICS = {
    "bailando_http_requests_total": (COUNTER, {"route", "method", "status"}),
    "bailando_http_request_duration_seconds": (HISTOGRAM, {"route"}),
    "bailando_queue_waiting": (GAUGE, set()),
    "bailando_requests_running": (GAUGE, set()),
    "bailando_queue_wait_seconds": (HISTOGRAM, set()),
    "bailando_batch_rows": (HISTOGRAM, set()),
    "bailando_step_duration_seconds": (HISTOGRAM, set()),
    "bailando_stage_duration_seconds": (HISTOGRAM, {"stage"}),
    "bailando_audio_seconds_total": (COUNTER, set()),
    "bailando_codes_total": (COUNTER, set()),
    "bailando_dances_total": (COUNTER, {"kind"}),
    "bailando_cancelled_total": (COUNTER, {"phase"}),
    "bailando_cancel_latency_seconds": (HISTOGRAM, set()),
    "bailando_rejected_total": (COUNTER, {"reason"}),
    "bailando_panics_total": (COUNTER, {"place"}),
    "bailando_connections": (GAUGE, set()),
    "bailando_uploads": (GAUGE, set()),
    "bailando_upload_bytes": (GAUGE, set()),
    "bailando_audio_seconds_in_flight": (GAUGE, set()),
    "bailando_jobs": (GAUGE, {"state"}),
    "bailando_build_info": (GAUGE, {"version", "model"}),
    "process_cpu_seconds_total": (COUNTER, set()),
    "process_resident_memory_bytes": (GAUGE, set()),
    "process_open_fds": (GAUGE, set()),
    "process_threads": (GAUGE, set()),
    "process_start_time_seconds": (GAUGE, set()),
}
# Prometheus' own.
TARGET_LABELS = {"job", "instance"}
SERIES = {"up": (None, TARGET_LABELS)}
for metric, (kind, labels) in METRICS.items():
    if kind == HISTOGRAM:
        for suffix in ("_bucket", "_sum", "_count"):
            extra = {"le"} if suffix == "_bucket" else set()
            SERIES[metric + suffix] = (metric, labels | TARGET_LABELS | extra)
    else:
        SERIES[metric] = (metric, labels | TARGET_LABELS)

COLUMNS = 24


class Problem(Exception):
    """A problem, in words for people."""


class Query:
    """The metrics of one PromQL expression, checked."""

    def __init__(self, text):
        self.metrics = set()
        self.labels = set()
        try:
            expression = promql_parser.parse(without_variables(text))
        except ValueError as error:
            raise Problem(f"{error}: {text}") from error
        promql_parser.walk(expression, pre_visit=self.select)

    def select(self, selector):
        """Checks one part of the expression if it is a selector, such as up{job="bailando"}."""
        if not isinstance(selector, promql_parser.VectorSelector):
            return
        if selector.name not in SERIES:
            raise Problem(f"the server has no metric {selector.name}")
        metric, labels = SERIES[selector.name]
        for matcher in selector.matchers.matchers:
            if matcher.name not in labels:
                raise Problem(f"{selector.name} has no label {matcher.name}")
        self.metrics.add(metric)
        self.labels |= labels

    def check_legend(self, legend):
        """Checks that the labels in a legend are those of the metrics."""
        for label in re.findall(r"{{\s*(\w+)\s*}}", legend):
            if label not in self.labels:
                raise Problem(f"no metric of the query has the label {label} of its legend")


def without_variables(text):
    """Returns the query as Prometheus gets it, with placeholders for Grafana's variables."""
    return re.sub(r"\$\{?\w+\}?", "x", re.sub(r"\$__(rate_interval|interval|range)", "5m", text))


def check_template(variable):
    """Checks the query of a dashboard's variable."""
    if variable["type"] == "datasource":
        return
    query = re.fullmatch(r"label_values\((.+), (\w+)\)", variable["query"]["query"])
    if not query:
        raise Problem("the query is not label_values(metric, label)")
    if query[2] not in Query(query[1]).labels:
        raise Problem(f"{query[1]} has no label {query[2]}")


def check_panel(panel):
    """Checks a panel that is no row; returns the metrics that it shows."""
    metrics = set()
    if not panel.get("description"):
        raise Problem("has no description")
    for target in panel["targets"]:
        for thing in (panel, target):
            if thing["datasource"]["uid"] != "${datasource}":
                raise Problem("does not use the variable for its data source")
        query = Query(target["expr"])
        query.check_legend(target["legendFormat"])
        metrics |= query.metrics
    return metrics


def check_place(panel, taken):
    """Checks that a panel is within the grid and overlaps no other."""
    place = panel["gridPos"]
    if place["x"] + place["w"] > COLUMNS:
        raise Problem("does not fit into the columns")
    for x in range(place["x"], place["x"] + place["w"]):
        for y in range(place["y"], place["y"] + place["h"]):
            if (x, y) in taken:
                raise Problem(f"lies on {taken[x, y]!r}")
            taken[x, y] = panel["title"]


def named(what, check, *arguments):
    """Calls a check; its problems name the place."""
    try:
        return check(*arguments)
    except Problem as problem:
        raise Problem(f"{what}: {problem}") from problem
    except KeyError as error:
        raise Problem(f"{what}: {error} is missing") from error


def check_dashboard(path):
    """Checks the whole dashboard; returns a summary."""
    with open(path, encoding="utf-8") as file:
        dashboard = json.load(file)
    if dashboard["schemaVersion"] < 39:
        raise Problem("the schema is older than that of Grafana 10")
    for variable in dashboard["templating"]["list"]:
        named(f"variable {variable['name']}", check_template, variable)
    ids, taken, shown, rows = set(), {}, set(), []
    for panel in dashboard["panels"]:
        title = panel["title"]
        if panel["id"] in ids:
            raise Problem(f"{title!r} has the id of another panel")
        ids.add(panel["id"])
        named(repr(title), check_place, panel, taken)
        if panel["type"] == "row":
            rows.append(title)
        else:
            shown |= named(repr(title), check_panel, panel)
    missing = METRICS.keys() - shown
    if missing:
        raise Problem(f"no panel shows {', '.join(sorted(missing))}")
    return f"{len(ids) - len(rows)} panels in {', '.join(rows)}"


def check_alert(rule):
    """Checks one alert."""
    Query(rule["expr"])
    if rule["labels"]["severity"] not in ("critical", "warning"):
        raise Problem("the severity is neither critical nor warning")
    for text in ("summary", "description"):
        if not rule["annotations"].get(text):
            raise Problem(f"has no {text}")


def check_alerts(path):
    """Checks all alerts; returns a summary."""
    with open(path, encoding="utf-8") as file:
        groups = yaml.safe_load(file)["groups"]
    rules = [rule for group in groups for rule in group["rules"]]
    for rule in rules:
        named(rule["alert"], check_alert, rule)
    return f"{len(rules)} alerts"


def main(paths):
    """Checks the files in order and ends with the first problem."""
    checks = (check_dashboard, check_alerts)
    if len(paths) != len(checks):
        sys.exit(__doc__)
    for check, path in zip(checks, paths):
        try:
            print(f"{path}: {named(path, check, path)}")
        except (Problem, OSError, ValueError, yaml.YAMLError) as error:
            sys.exit(f"check-metrics: {error}")


if __name__ == "__main__":
    main(sys.argv[1:])
