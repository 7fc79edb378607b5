"""Numbers for Prometheus, offered if the configuration has `metrics`; docs/metrics.md lists their names.

A drone's metrics (`drone`) are counted from the events of its log as they are written: no call waits for a scrape.
A daemon (`daemon`) counts its requests and what happens to its instances. Its state is read on its own event loop at
each scrape.

`exposition` answers scrapes in a thread, so that a busy program answers too.
"""

CALL_S = (0.05, 0.1, 0.2, 0.3, 0.5, 0.75, 1.0, 1.5, 2.0, 3.0, 5.0, 7.5, 10.0, 15.0, 20.0, 30.0, 60.0)
