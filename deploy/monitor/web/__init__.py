"""`eia-sec watch`: from a worker's view messages to a picture in the browser.

`source` asks a worker and checks what comes, `packets` says it in the browser's words, `hub` keeps the recent past and
hands it out, `server` is the small web server, `page/` is what the browser loads.
"""
