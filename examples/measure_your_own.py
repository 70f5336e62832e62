"""Register a measure of your own; it appears in comparisons, benchmarks and their report."""

from mmc_gym.benchmark.compare import compare
from mmc_gym.measures import Episode, measure


@measure(label="half-way time", unit="s", best="low", shown=True, successes_only=True)
def half_way_time(episode: Episode) -> float:
    """Return the seconds until the hand has covered half of its way to the target."""
    half_way = episode.distances <= episode.distances[0] / 2
    return int(half_way.argmax()) * episode.control_step


if __name__ == "__main__":
    print(compare(["mmc", "ik-dls"], episodes=20))
