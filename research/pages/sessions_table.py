"""The table of what many workers cost a router."""

from typing import Any

from research.pages.blocks import table

HEADINGS = (
    "workers",
    "sites",
    "join, s",
    "router while they join, s of a core",
    "router then, cores",
    "a site's router, cores",
    "reports a second and worker",
    "of them lost",
    "descriptors",
    "memory, MB",
    "parameters arrive after, ms (median, 99 %)",
)


def page(data: dict[str, Any]) -> str:
    """Return the results as a page."""
    return "\n".join(["# Many workers at one router", "", sessions_block(data), ""])


def sessions_block(data: dict[str, Any]) -> str:
    """Return a row for each number of workers, and where the numbers come from."""
    rows = [_row(result) for result in data["results"] if not result["without"]]
    made = f"Made by `{data['command']}`, commit {data['commit']}, {data['cores']} cores."
    return "\n".join([table(HEADINGS, rows), "", made])


def _row(result: dict[str, Any]) -> list[str]:
    delay = result["parameters_seconds"]
    return [
        f"{result['workers']:,}",
        f"{result['sites']}" if result["sites"] else "-",
        f"{result['join_seconds']:.1f}",
        f"{result['router_join_cpu_seconds']:.1f}",
        f"{result['router_cores']:.2f}",
        f"{max(result['site_cores']):.2f}" if result["sites"] else "-",
        f"{result['metrics_rate']:.2f}",
        f"{result['metrics_lost']:.1%}",
        f"{result['router_descriptors']:,}",
        f"{result['router_megabytes']:,}",
        f"{1e3 * delay['median']:.0f}, {1e3 * delay['p99']:.0f}",
    ]
