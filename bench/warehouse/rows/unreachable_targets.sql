SELECT scene_id, instance_id, 'the free floor near it is 1.30 m away, view points reach 1 m' AS reason
FROM objects_now
WHERE u(object, 'reach') < 0.015
