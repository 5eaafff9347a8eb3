"""A process with a Ray cluster of two nodes, one of which can be told to die.

    python tests/ray_nodes.py

It prints the cluster's address. The line `kill` on stdin kills the second node; the end of stdin
ends all.
"""

import os
import sys
from typing import Any

os.environ["RAY_USAGE_STATS_ENABLED"] = "0"


def main() -> None:
    from ray.cluster_utils import Cluster  # pyright: ignore[reportMissingImports]

    store: dict[str, Any] = {"object_store_memory": 80 * 2**20, "num_cpus": 1, "memory": 8 * 10**9}
    cluster = Cluster(initialize_head=True, head_node_args={**store, "include_dashboard": False})
    second = cluster.add_node(**store)
    cluster.wait_for_nodes()
    print("address", cluster.address, flush=True)
    for line in sys.stdin:
        if line.strip() == "kill":
            cluster.remove_node(second, allow_graceful=False)
            print("killed", flush=True)
    cluster.shutdown()


if __name__ == "__main__":
    main()
