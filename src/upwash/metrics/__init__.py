"""Numbers for Prometheus, offered if the configuration has `metrics`; docs/metrics.md lists their names.

A drone's metrics (`drone`) are counted from the events of its log as they are written, so that a call never waits for
a scrape. A daemon's (`daemon`) are of two kinds: its requests and the ends and calls of its instances are counted as
they happen, and its state is read on its own event loop at each scrape.

`exposition` answers scrapes in a thread with a loop of its own. Its bounds are why it is not an ASGI
application on uvicorn. uvicorn limits neither the time for a request to arrive nor the time for a reply to be read,
turns away the newest connection instead of the oldest, and would be one more requirement of a drone with metrics.
"""

CALL_S = (0.05, 0.1, 0.2, 0.3, 0.5, 0.75, 1.0, 1.5, 2.0, 3.0, 5.0, 7.5, 10.0, 15.0, 20.0, 30.0, 60.0)
