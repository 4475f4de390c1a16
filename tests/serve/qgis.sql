-- version
SELECT postgis_version();

-- capabilities
SELECT postgis_geos_version(), postgis_proj_version();

-- topology
SELECT has_schema_privilege(n.oid, 'usage') AND has_table_privilege(t.oid, 'select') AND has_table_privilege(l.oid, 'select') FROM pg_namespace n, pg_class t, pg_class l WHERE n.nspname = 'topology' AND t.relnamespace = n.oid AND l.relnamespace = n.oid AND t.relname = 'topology' AND l.relname = 'layer';

-- pointcloud
SELECT has_table_privilege(c.oid, 'select') AND has_table_privilege(f.oid, 'select') FROM pg_class c, pg_class f, pg_namespace n, pg_extension e WHERE c.relnamespace = n.oid AND c.relname = 'pointcloud_columns' AND f.relnamespace = n.oid AND f.relname = 'pointcloud_formats' AND n.oid = e.extnamespace AND e.extname = 'pointcloud';

-- raster
SELECT has_table_privilege(c.oid, 'select') FROM pg_class c, pg_namespace n, pg_type t WHERE c.relnamespace = n.oid AND n.oid = t.typnamespace AND c.relname = 'raster_columns' AND t.typname = 'raster';

-- client
SET application_name='QGIS';

-- digits
SET extra_float_digits=3;

-- schemas
SELECT nspname, pg_get_userbyid(nspowner), pg_catalog.obj_description(oid) FROM pg_namespace WHERE nspname !~ '^pg_' AND nspname != 'information_schema' ORDER BY nspname;

-- layers
SELECT l.f_table_name,l.f_table_schema,l.f_geometry_column,upper(l.type),l.srid,l.coord_dimension,c.relkind,obj_description(c.oid),array_agg(a.attname ORDER BY a.attnum), count(CASE WHEN t.typname IN ('geometry','geography') THEN 1 ELSE NULL END) , 1  FROM geometry_columns l,pg_class c,pg_namespace n,pg_attribute a,pg_type t WHERE c.relname=l.f_table_name AND l.f_table_schema=n.nspname AND NOT a.attisdropped AND a.attrelid=c.oid AND a.atttypid=t.oid AND a.attnum>0 AND n.oid=c.relnamespace AND has_schema_privilege(n.nspname,'usage') AND has_table_privilege(c.oid,'select') AND n.nspname='public' AND l.f_table_schema='public' GROUP BY 1,2,3,4,5,6,7,c.oid,11 UNION SELECT l.f_table_name,l.f_table_schema,l.f_geography_column,upper(l.type),l.srid,2,c.relkind,obj_description(c.oid),array_agg(a.attname ORDER BY a.attnum), count(CASE WHEN t.typname IN ('geometry','geography') THEN 1 ELSE NULL END) , 2  FROM geography_columns l,pg_class c,pg_namespace n,pg_attribute a,pg_type t WHERE c.relname=l.f_table_name AND l.f_table_schema=n.nspname AND NOT a.attisdropped AND a.attrelid=c.oid AND a.atttypid=t.oid AND a.attnum>0 AND n.oid=c.relnamespace AND has_schema_privilege(n.nspname,'usage') AND has_table_privilege(c.oid,'select') AND n.nspname='public' AND l.f_table_schema='public' GROUP BY 1,2,3,4,5,6,7,c.oid,11 ORDER BY 2,1,3;

-- others
SELECT c.relname,n.nspname,a.attname,c.relkind,CASE WHEN t.typname IN ('geometry','geography') THEN t.typname ELSE b.typname END AS coltype,obj_description(c.oid) FROM pg_attribute a JOIN pg_class c ON c.oid=a.attrelid JOIN pg_namespace n ON n.oid=c.relnamespace JOIN pg_type t ON t.oid=a.atttypid LEFT JOIN pg_type b ON b.oid=t.typbasetype WHERE c.relkind IN ('v','r','m','p','f') AND has_schema_privilege( n.nspname, 'usage' ) AND has_table_privilege( c.oid, 'select' ) AND (t.typname IN ('geometry','geography') OR b.typname IN ('geometry','geography')) AND n.nspname='public' AND n.nspname='public' AND NOT EXISTS (SELECT 1 FROM geometry_columns WHERE n.nspname=f_table_schema AND c.relname=f_table_name AND a.attname=f_geometry_column) AND NOT EXISTS (SELECT 1 FROM geography_columns WHERE n.nspname=f_table_schema AND c.relname=f_table_name AND a.attname=f_geography_column);

-- tables
SELECT pg_class.relname,pg_namespace.nspname,pg_class.relkind,obj_description(pg_class.oid),array_agg(a.attname ORDER BY a.attnum) FROM  pg_class,pg_namespace,pg_attribute a WHERE pg_namespace.oid=pg_class.relnamespace AND has_schema_privilege(pg_namespace.nspname,'usage') AND has_table_privilege(pg_class.oid,'select') AND pg_class.relkind IN ('v','r','m','p','f') AND pg_class.oid = a.attrelid AND NOT a.attisdropped AND a.attnum > 0 AND pg_namespace.nspname='public' AND pg_namespace.nspname='public' GROUP BY 1,2,3,4;

-- geometries
SELECT 0, array_agg(DISTINCT st_srid("geometry")::text || ':' || UPPER(geometrytype("geometry"))  || ':' || ST_Zmflag("geometry"))  FROM (SELECT "geometry" FROM "public"."lanes") AS _unused;

-- recovery
SELECT pg_is_in_recovery();

-- column
SELECT upper(type),srid,coord_dimension FROM geometry_columns WHERE f_table_name='lanes' AND f_geometry_column='geometry' AND f_table_schema='public';

-- description
SELECT description FROM pg_description WHERE objoid=regclass('"public"."lanes"')::oid AND objsubid=0;

-- types
SELECT oid,typname,typtype,typelem,typlen FROM pg_type WHERE oid in (25,701,1016,90001,20);

-- widgets
SELECT EXISTS ( SELECT oid FROM pg_catalog.pg_class WHERE relname='qgis_editor_widget_styles');

-- children
SELECT count(*) FROM pg_inherits WHERE inhparent='"public"."lanes"'::regclass;

-- key
SELECT indexrelid FROM pg_index WHERE indrelid='"public"."lanes"'::regclass AND (indisprimary OR indisunique) ORDER BY CASE WHEN indisprimary THEN 1 ELSE 2 END LIMIT 1;

-- system
SELECT auth_name, auth_srid, srtext, proj4text FROM spatial_ref_sys WHERE srid=0;

-- styles
SELECT EXISTS ( SELECT oid FROM pg_catalog.pg_class WHERE relname='layer_styles');

-- number
SELECT regclass('pg_class')::oid AS oidselect;

-- extent
SELECT st_extent("geometry") FROM "public"."lanes"
