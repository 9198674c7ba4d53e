{% if part == "equations" %}
  force_stop = stop_stiffness*(s_rel - max(min(s_rel, stop_gap), -stop_gap));
{% endif %}
