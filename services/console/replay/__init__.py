"""A recorded mission, played: the client, the queries and the page of a live mission, over its recording."""
