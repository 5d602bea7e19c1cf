"""Script: request /livez every 10 ms until standard input closes.

It prints the number of answers and the longest response time [ms]. It runs in a separate process, so the load of the
test does not affect its measurements.
"""

import http.client
import select
import sys
import time


def main(port: int) -> None:
    connection = http.client.HTTPConnection("127.0.0.1", port)
    slowest, count = 0.0, 0
    while not select.select([sys.stdin], [], [], 0.0)[0]:
        begin = time.perf_counter()
        connection.request("GET", "/livez")
        answer = connection.getresponse()
        answer.read()
        slowest = max(slowest, time.perf_counter() - begin)
        count += 1
        if answer.status != http.client.OK:
            sys.exit(f"/livez answered {answer.status}")
        time.sleep(0.01)
    sys.stdout.write(f"{count} {slowest * 1e3}\n")


if __name__ == "__main__":
    main(int(sys.argv[1]))
