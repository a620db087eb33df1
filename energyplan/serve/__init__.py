"""An HTTP service: plans, comparisons, checks, missions and diagnoses for other programs.

It needs the extra ``serve`` (FastAPI and uvicorn). ``energyplan serve FOLDER`` starts it on the
loopback address; `create_app` gives the application to any other ASGI server.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach(
    __name__, submod_attrs={"api": ["create_app"], "run": ["run"]}
)
