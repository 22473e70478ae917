"""Runs that are stopped on their way."""


class Stopped(Exception):
    """What stops a run."""


def stop_after(steps):
    def on_step(done, _total):
        if done == steps:
            raise Stopped

    return on_step
