"""The recording of compilations within a block of a test."""

import jax


class Compiled(list):
    """The names of the programs that are compiled within a `with` block."""

    def __enter__(self):
        jax.monitoring.register_event_duration_secs_listener(self.listen)
        return self

    def __exit__(self, *_):
        jax.monitoring.unregister_event_duration_listener(self.listen)

    def listen(self, event, seconds, **about):
        if event.endswith("backend_compile_duration"):
            self.append(about.get("fun_name"))
