"""The demonstration: a survey over two edge servers, with every program on this machine."""
