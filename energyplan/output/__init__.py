"""What people and programs get to see: figures, pages, JSON documents and lines of text."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach(
    __name__, ["documents", "pages", "plots", "text"]
)
