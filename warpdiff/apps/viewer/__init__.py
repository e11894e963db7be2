"""Interactive viewer: a web page that shows a mesh, and the server that renders the pictures.

In: values of the page's controls, files named on the command line.
Out: pictures of increasing quality; picture files; lines of code that reproduce a picture.
"""
