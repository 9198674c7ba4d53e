{{ about | commented("# ") }}
# Material 1 is spring and joint, in N, m and kg; mass and zeta are the model's.
{% if notes %}
{{ notes | commented("# ") }}
{% endif %}
{% for line in lines %}
{{ line }}
{% endfor %}
