"""An episode to look at: the scene as data, the page that draws it, and where its moments come from."""
