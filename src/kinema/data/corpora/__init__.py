"""Build corpora anew from what their owners publish: the recipes are here, the captures are not."""
