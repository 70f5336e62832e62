"""The report of a benchmark: one HTML file with words, tables, figures and a replay."""

from mmc_gym.report.render import write_report

__all__ = ["write_report"]
